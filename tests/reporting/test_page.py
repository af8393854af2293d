"""Laws of a page: text stays text, the verdict comes first, nothing is loaded from elsewhere, and
all that is seen is also said."""

import base64
import html
import io
import itertools
import json
import re
from html.parser import HTMLParser

import numpy as np
import pytest
from invented_laps import invent_laps
from PIL import Image

from jaxtube.reporting import document
from jaxtube.reporting.alternatives import describe_figure, plain
from jaxtube.reporting.document import MOST_BYTES, render
from jaxtube.reporting.page import (
    Bar,
    Bars,
    ConditionRow,
    Conditions,
    Heading,
    Interval,
    Intervals,
    Listing,
    Page,
    Picture,
    Run,
    Section,
    Table,
    Words,
)
from jaxtube.reporting.player import make_player

HOSTILE = "</script><script>alert(1)</script><img src=x onerror=alert(1)>\"'&<!--"
VOID = {"meta", "link", "img", "input", "br", "path", "rect", "circle"}


class Outline(HTMLParser):
    """The elements of a page in their order, the text of each, and what was left open."""

    def __init__(self, text):
        super().__init__(convert_charrefs=True)
        self.elements = []
        self.texts = []
        self.open = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open and self.open[-1] == tag, (tag, self.open[-3:])
        self.open.pop()

    def handle_data(self, data):
        self.texts.append((self.open[-1] if self.open else "", data))

    def all(self, tag):
        return [attributes for name, attributes in self.elements if name == tag]

    def text_of(self, tag):
        return [data for name, data in self.texts if name == tag]


def make_png(width=120, height=80):
    noise = np.random.default_rng(0).integers(0, 256, (height, width, 3), np.uint8)
    file = io.BytesIO()
    Image.fromarray(noise).save(file, format="png")
    return file.getvalue()


def make_page(word="word", player=None):
    """Return a page that has one of everything, with a word in every place that takes text."""
    parts = [
        Table(word, [Heading(word), Heading(word, True)], [[word, Words(word, "bad")]], word),
        Bars(word, [Bar(word, 0.4, word), Bar(word, float("nan"), word)], word),
        Intervals(word, [Interval(word, word, 0.1, 0.01, 0.2)], word),
        Conditions(word, [ConditionRow(word, False, True, "robot", -0.2, word, word)], word),
        Listing([word], word),
        Listing([word], bulleted=False),
    ]
    return Page(word, "bad", [word], [Section(word, parts)], [word], player)


def make_run(word="word", pictures=1):
    manifest = {
        "command_line": word,
        "date": word,
        "packages": {"jaxtube": word},
        "devices": [word],
    }
    drawn = [Picture(word, word, word, make_png()) for _ in range(pictures)]
    return Run(word, word, manifest, drawn)


@pytest.fixture(scope="module")
def page():
    return Outline(render(make_page(player=make_player(invent_laps())), make_run()))


def test_a_page_begins_as_html():
    assert render(make_page(), make_run()).startswith("<!doctype html>")


def test_every_element_is_closed(page):
    assert page.open == []


def test_the_verdict_is_the_first_text_that_is_read(page):
    headings = [tag for tag, _ in page.elements if re.fullmatch("h[1-6]", tag)]
    assert headings[0] == "h1" and headings.count("h1") == 1
    of_body = [data.strip() for tag, data in page.texts if tag not in ("style", "title")]
    shown = [data for data in of_body if data and data != "Skip to the report"]
    assert shown[0] == "word"
    assert page.text_of("h1") == ["word"]


def test_headings_descend_one_level_at_a_time(page):
    levels = [int(tag[1]) for tag, _ in page.elements if re.fullmatch("h[1-6]", tag)]
    assert all(following <= level + 1 for level, following in itertools.pairwise(levels))


@pytest.mark.parametrize("hostile", [HOSTILE, "{{ 7 * 7 }}{% raw %}", "\u2028\u2029\0"])
def test_text_stays_text_wherever_it_stands(hostile):
    laps = invent_laps(names=("tube_mpc", hostile))
    outline = Outline(render(make_page(hostile, make_player(laps, hostile)), make_run(hostile)))
    usual = Outline(render(make_page(player=make_player(laps)), make_run()))
    assert [tag for tag, _ in outline.elements] == [tag for tag, _ in usual.elements]
    assert not any("onerror" in attributes for _, attributes in outline.elements)
    shown = "".join(data for _, data in outline.texts)
    assert "49" not in outline.text_of("h1")
    if "\0" not in hostile:
        assert hostile in outline.text_of("h1")[0] and hostile in shown


def test_words_in_backticks_are_code():
    outline = Outline(render(make_page("the limit `<input>` of `E`"), make_run()))
    assert outline.text_of("h1") == ["the limit ", " of "]
    assert {"<input>", "E"} == set(outline.text_of("code")) - {"word"}


def test_laps_come_back_from_the_page_as_they_were_given():
    player = make_player(invent_laps(names=("tube_mpc", HOSTILE)), HOSTILE)
    text = render(make_page(player=player), make_run())
    (data,) = re.findall(r'<script type="application/json" id="laps">(.*?)</script>', text, re.S)
    assert json.loads(data) == player


def test_every_picture_is_told_in_words_and_keeps_its_size_and_colours(page):
    (image,) = page.all("img")
    assert image["alt"] == "word"
    assert (image["width"], image["height"]) == ("120", "80")
    head, data = image["src"].split(";base64,")
    assert head in ("data:image/webp", "data:image/png")
    shown = np.asarray(Image.open(io.BytesIO(base64.b64decode(data))).convert("RGB"))
    drawn = np.asarray(Image.open(io.BytesIO(make_png())))
    np.testing.assert_array_equal(shown, drawn)


def test_nothing_is_loaded_from_elsewhere(page):
    for tag, attributes in page.elements:
        for name in ("src", "srcset", "poster", "data", "action"):
            assert attributes.get(name, "data:").startswith("data:"), (tag, name)
        if tag == "link":
            assert attributes["href"] == "data:,"
    style = "".join(page.text_of("style"))
    assert "url(" not in style and "@import" not in style
    script = "".join(page.text_of("script"))
    assert not re.search(r"fetch\(|XMLHttpRequest|WebSocket|import\(|https?://", script)
    (policy,) = [each for each in page.all("meta") if "http-equiv" in each]
    assert "default-src 'none'" in policy["content"]


def test_a_page_stays_small_and_links_what_has_no_room(monkeypatch):
    assert MOST_BYTES < 5e6
    pictures = 8
    monkeypatch.setattr(document, "MOST_BYTES", 160_000)
    text = render(make_page(), make_run(pictures=pictures))
    assert len(text.encode()) < 160_000
    outline = Outline(text)
    assert 0 < len(outline.all("img")) < pictures
    linked = [each for each in outline.all("a") if each["href"] == "word.png"]
    assert len(linked) + len(outline.all("img")) == pictures


def test_tables_have_headings_for_columns_and_rows(page):
    scopes = [each["scope"] for each in page.all("th")]
    assert scopes == ["col", "col", "row"]


def test_controls_have_names(page):
    labels = page.all("label")
    named = [each for each in (*page.all("select"), *page.all("input")) if "aria-label" not in each]
    assert len(labels) == len(named) == len(page.all("select"))
    assert page.all("html")[0]["lang"] == "en"
    assert len(page.all("main")) == len(page.all("header")) == len(page.all("footer")) == 1


def test_every_anchor_that_is_pointed_to_is_there(page):
    ids = [attributes["id"] for _, attributes in page.elements if "id" in attributes]
    assert len(ids) == len(set(ids))
    pointed = [each["href"][1:] for each in page.all("a") if each["href"].startswith("#")]
    referred = [
        name
        for _, attributes in page.elements
        for key in ("aria-labelledby", "aria-describedby", "for")
        for name in attributes.get(key, "").split()
    ]
    assert set(pointed) | set(referred) <= set(ids)


def test_without_laps_there_is_no_script():
    outline = Outline(render(make_page(), make_run()))
    assert outline.all("script") == outline.all("canvas") == []


@pytest.mark.parametrize(
    ("share", "percent", "tone"),
    [(0.0, 0, "good"), (0.75, 50, "good"), (1.0, 200 / 3, "good"), (1.01, 67.3, "bad")],
)
def test_bars_are_as_long_as_their_share_of_the_limit(share, percent, tone):
    bar = Bar("", share, "")
    assert bar.percent == pytest.approx(percent, abs=0.1)
    assert bar.tone == tone


@pytest.mark.parametrize("share", [np.nan, np.inf, 7.0])
def test_what_is_no_number_is_drawn_beyond_the_limit(share):
    bar = Bar("", share, "")
    assert (bar.percent, bar.tone) == (100, "bad")


def test_shares_keep_their_order_on_the_logarithmic_axis():
    rows = [Interval("", "", share, share / 2, share) for share in (1e-4, 1e-2, 0.5, 1.0)]
    part = Intervals("", rows)
    places = [part.place(row.share) for row in rows]
    assert places == sorted(places) and places[-1] == 100
    assert part.place(0.0) == 0
    assert places[1] - places[0] == pytest.approx(200 / part.decades)


def test_a_figure_in_words_names_panels_axes_ranges_and_legend():
    from matplotlib.figure import Figure

    figure = Figure()
    first, second = figure.subplots(2, 1, sharex=True)
    first.plot([0, 1], [-1, 1], "k--", label="limits of $\\mathcal{E}$")
    first.plot([0, 10, 20, 40], [0, 1, 2, 9], "r", label="a curve")
    first.set(ylabel="$e_{\\theta}$ [deg]", title="whole lap", ylim=(-3, 3))
    second.set(xlabel="time [s]", xlim=(0, 30), yticks=[0, 1])
    second.set_yticklabels(["with", "without"])
    first.legend()
    told = describe_figure(figure)
    for words in ("2 panels", "“whole lap”", "e_theta [deg], from -3 to 3", "limits of E"):
        assert words in told
    assert told.count("time [s], from 0 to 30") == 2
    assert "a curve 0 to 2" in told  # within the panel: the last point is outside
    assert "$" not in told and "\\" not in told


@pytest.mark.parametrize(
    ("latex", "text"),
    [
        ("$\\mathcal{E}$", "E"),
        ("$R_{12}$ of “x”", "R_12 of “x”"),
        ("$e^\\top P\\,e$", "e^T P e"),
        ("100 %\nof it", "100 % of it"),
    ],
)
def test_latex_becomes_plain_text(latex, text):
    assert plain(latex) == text
    assert html.escape(text)
