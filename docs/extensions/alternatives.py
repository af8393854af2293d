"""Every picture needs a text that says what it shows, for those who do not see it."""

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util import logging

logger = logging.getLogger(__name__)


def warn_of_silent_pictures(app: Sphinx, doctree: nodes.document, page: str) -> None:
    """Warn of every picture of a page without an alternative text."""
    for image in doctree.findall(nodes.image):
        if not image.get("alt"):
            logger.warning("a picture has no alternative text", location=image)


def setup(app: Sphinx) -> dict[str, bool]:
    """Look at pages once their cells have run."""
    app.connect("doctree-resolved", warn_of_silent_pictures)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
