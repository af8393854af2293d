"""What the page in a run folder says first."""

import html
import re
from pathlib import Path


def find_first_lines(folder):
    """Return the verdict on the page of a run, and the first line of its printed report."""
    page = (Path(folder) / "report.html").read_text(encoding="utf-8")
    verdict = re.search("<h1[^>]*>(.*?)</h1>", page, re.DOTALL)
    assert verdict
    printed = (Path(folder) / "report.txt").read_text(encoding="utf-8")
    return html.unescape(re.sub("</?code>", "`", verdict[1])), printed.split("\n")[0]
