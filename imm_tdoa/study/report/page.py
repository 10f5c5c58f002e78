"""Pieces of a web page that needs nothing but itself: elements, tables, pictures."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from xml.etree import ElementTree

from imm_tdoa.study.report.paper import Picture

Node = ElementTree.Element
Part = Node | str

STYLE = """
:root { color-scheme: light; }
* { box-sizing: border-box; }
html { -webkit-text-size-adjust: 100%; scroll-behavior: smooth; }
body { margin: 0; background: #fff; color: #222; line-height: 1.5;
       font: 16px/1.5 system-ui, -apple-system, "Segoe UI", Roboto, sans-serif; }
main, header, footer { max-width: 50rem; margin: 0 auto; padding: 0 1rem; }
header { padding-top: 1.5rem; }
h1 { font-size: 1.7rem; line-height: 1.2; margin: 0 0 .5rem; overflow-wrap: anywhere; }
h2 { font-size: 1.3rem; margin: 2.2rem 0 .6rem; border-bottom: 1px solid #ddd; }
h3 { font-size: 1.08rem; margin: 1.8rem 0 .4rem; overflow-wrap: anywhere; }
p, ul, ol { margin: .5rem 0; overflow-wrap: anywhere; }
li { margin: .3rem 0; }
nav { background: #f6f7f8; border-radius: 6px; padding: .6rem 1rem; margin: 1rem 0;
      max-height: 22rem; overflow-y: auto; }
nav ol { margin: .2rem 0; padding-left: 1.4rem; }
a { color: #00558f; }
.question { font-size: 1.1rem; color: #444; }
.short { background: #f0f6f1; border-left: 4px solid #009e73; padding: .4rem 1rem; }
.short h2 { margin-top: .4rem; border: 0; }
figure { margin: 1.2rem 0; }
figure img { display: block; width: 100%; max-width: 42rem; height: auto; }
figcaption { color: #555; font-size: .9rem; margin-top: .3rem; max-width: 42rem; }
.scroll { overflow-x: auto; margin: .8rem 0; max-width: 100%; }
table { border-collapse: collapse; font-size: .9rem; font-variant-numeric: tabular-nums; }
th, td { padding: .3rem .6rem; text-align: right; vertical-align: top; white-space: nowrap;
         border-bottom: 1px solid #e5e5e5; }
th { font-weight: 600; background: #f6f7f8; }
th:first-child, td:first-child { text-align: left; white-space: normal; min-width: 7rem; }
td small { display: block; color: #666; font-size: .82rem; }
td.best { background: #e6f3ea; }
pre { background: #f6f7f8; padding: .7rem 1rem; overflow-x: auto; font-size: .82rem;
      border-radius: 6px; max-height: 32rem; }
dt { font-weight: 600; } dd { margin: 0 0 .4rem 1rem; overflow-wrap: anywhere; }
footer { color: #666; font-size: .9rem; padding-top: 2rem; padding-bottom: 2rem; }
@media print { nav { display: none; } figure, table { break-inside: avoid; } }
"""


def element(tag: str, *parts: Part, **attributes: str) -> Node:
    """Return an element; text is escaped when the page is written.

    Attribute names lose a trailing underscore (``class_``).
    """
    node = ElementTree.Element(tag, {k.rstrip("_"): v for k, v in attributes.items()})
    last: Node | None = None
    for part in parts:
        if not isinstance(part, str):
            node.append(part)
            last = part
        elif last is None:
            node.text = (node.text or "") + part
        else:
            last.tail = (last.tail or "") + part
    return node


def bullets(sentences: Sequence[str]) -> Node:
    """Return sentences as a list."""
    unbroken = (sentence.replace(" %", "\u00a0%") for sentence in sentences)
    return element("ul", *(element("li", sentence) for sentence in unbroken))


def picture(drawn: Picture) -> Node:
    """Return a picture with its caption, the picture itself inside."""
    data = base64.b64encode(drawn.png).decode("ascii")
    width, height = drawn.size
    image = element(
        "img",
        src=f"data:image/png;base64,{data}",
        alt=drawn.alt,
        width=str(width),
        height=str(height),
    )
    caption = element("figcaption", drawn.caption)
    return element("figure", image, caption, id=f"picture-{drawn.name}")


def table(heads: Sequence[Part], rows: Sequence[Sequence[Part | tuple[str, str, bool]]]) -> Node:
    """Return a table that scrolls inside its own box where it is too wide.

    Cells are text, an element, or (figure, what stands small beneath, whether it is among the
    best).
    """
    top = element("tr", *(element("th", head, scope="col") for head in heads))
    body = element("tbody", *(element("tr", *(_cell(cell) for cell in row)) for row in rows))
    inner = element("table", element("thead", top), body)
    return element("div", inner, class_="scroll", tabindex="0")


def _cell(cell: Part | tuple[str, str, bool]) -> Node:
    if not isinstance(cell, tuple):
        return element("td", cell)
    text, small, best = cell
    parts: list[Part] = [text, element("small", small)] if small else [text]
    return element("td", *parts, **({"class_": "best"} if best else {}))


def write(title: str, *parts: Node) -> str:
    """Return the page."""
    head = element(
        "head",
        element("meta", charset="utf-8"),
        element("meta", name="viewport", content="width=device-width, initial-scale=1"),
        element("title", title),
        element("link", rel="icon", href="data:,"),
        element("style", STYLE),
    )
    whole = element("html", head, element("body", *parts), lang="en")
    text = ElementTree.tostring(whole, encoding="unicode", method="html")
    return f"<!DOCTYPE html>\n{text}\n"
