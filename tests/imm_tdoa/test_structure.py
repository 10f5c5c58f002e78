"""TOML to frozen classes: what is taken, and the place of everything that is not."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import attrs
import pytest

from imm_tdoa._structure import near, parse, read, structure


def _positive(_: Any, field: attrs.Attribute[Any], value: float) -> None:
    if value <= 0.0:
        raise ValueError(f"{field.name}: expected a number above 0, got {value!r}")


@attrs.frozen
class Part:
    """A table in a list."""

    size: float = attrs.field(validator=_positive)
    tags: tuple[str, ...] = ()

    def __attrs_post_init__(self) -> None:
        if len(set(self.tags)) != len(self.tags):
            raise ValueError("expected different tags")


@attrs.frozen
class Whole:
    """A file."""

    count: int
    title: str = ""
    open: bool = False
    limit: float | None = None
    matrix: tuple[tuple[float, ...], ...] = ()
    weights: Mapping[str, float] = attrs.field(factory=dict)
    main: Part | None = None
    parts: tuple[Part, ...] = ()
    steps: tuple[int, ...] | None = None
    rows: tuple[Mapping[str, Any], ...] = ()
    free: Mapping[str, Any] = attrs.field(factory=dict)

    def __attrs_post_init__(self) -> None:
        if len(self.parts) > 2:
            raise ValueError(f"parts[2].size: expected at most two, got {len(self.parts)}")


def make(text: str) -> Whole:
    return structure(parse(text, "a.toml"), Whole, "a.toml")


def test_everything_is_taken() -> None:
    made = make(
        """
        count = 3
        title = "all"
        open = true
        limit = 2
        matrix = [[1, 2.5], []]
        weights = { a = 1, "b c" = 0.5 }
        main.size = 1e3
        steps = [1, 2]
        rows = [{ a = "x" }]
        [[parts]]
        size = 1
        tags = ["p", "q"]
        [[parts]]
        size = 2
        [free]
        any = [1, "a", { b = inf }]
        """
    )
    assert made == Whole(
        count=3,
        title="all",
        open=True,
        limit=2.0,
        matrix=((1.0, 2.5), ()),
        weights={"a": 1.0, "b c": 0.5},
        main=Part(1000.0),
        parts=(Part(1.0, ("p", "q")), Part(2.0)),
        steps=(1, 2),
        rows=({"a": "x"},),
        free={"any": [1, "a", {"b": float("inf")}]},
    )
    assert isinstance(made.limit, float)
    assert isinstance(made.matrix[0][0], float)


def test_what_is_left_out_has_its_default() -> None:
    assert make("count = 1") == Whole(1)


FAULTS = [
    # keys
    ("", "count: missing"),
    ("count = 1\n[main]", "main.size: missing"),
    ("count = 1\n[[parts]]\nsize = 1\n[[parts]]", "parts[1].size: missing"),
    (
        "count = 1\ntitel = 'a'",
        "titel: unknown key (did you mean 'title'?); there are: count, title, open, limit, "
        "matrix, weights, main, parts, steps, rows, free",
    ),
    (
        "count = 1\nparts = [{ size = 1, colour = 'red' }]",
        "parts[0].colour: unknown key; there are: size, tags",
    ),
    # an unknown key goes before the key that is missing because of it
    ("coutn = 1", "coutn: unknown key (did you mean 'count'?); there are: count, title, open,"),
    # kinds of values
    ("count = 1.0", "count: expected a whole number, got 1.0"),
    ("count = true", "count: expected a whole number, got True"),
    ("count = '1'", "count: expected a whole number, got '1'"),
    ("count = 1\ntitle = 3", "title: expected text in quotes, got 3"),
    ("count = 1\nopen = 1", "open: expected true or false, got 1"),
    ("count = 1\nlimit = '1'", "limit: expected a number, got '1'"),
    ("count = 1\nlimit = true", "limit: expected a number, got True"),
    ("count = 1\nlimit = nan", "limit: expected a finite number, got nan"),
    ("count = 1\nmain = 3", "main: expected a table, got 3"),
    ("count = 1\nfree = [3]", "free: expected a table, got [3]"),
    ("count = 1\nweights = 3", "weights: expected a table, got 3"),
    ("count = 1\nweights = { a = 'x' }", "weights.a: expected a number, got 'x'"),
    ("count = 1\nparts = 3", "parts: expected tables in double brackets, got 3"),
    ("count = 1\n[parts]\nsize = 1", "parts: expected tables in double brackets, got {'size': 1}"),
    ("count = 1\nparts = [3]", "parts[0]: expected a table, got 3"),
    ("count = 1\nrows = 3", "rows: expected tables in double brackets, got 3"),
    ("count = 1\nrows = [3]", "rows[0]: expected a table, got 3"),
    ("count = 1\nsteps = 3", "steps: expected a list of whole numbers, got 3"),
    ("count = 1\nsteps = [3, 4.5]", "steps[1]: expected a whole number, got 4.5"),
    ("count = 1\nmatrix = 3", "matrix: expected a list of lists of numbers, got 3"),
    ("count = 1\nmatrix = [3]", "matrix[0]: expected a list of numbers, got 3"),
    ("count = 1\nmatrix = [[1], [2, 'a']]", "matrix[1][1]: expected a number, got 'a'"),
    (
        "count = 1\nparts = [{ size = 1, tags = 'ab' }]",
        "parts[0].tags: expected a list of texts in quotes, got 'ab'",
    ),
    # what the classes refuse: a field, a class as a whole, a place of its own
    ("count = 1\nmain.size = -1", "main.size: expected a number above 0, got -1.0"),
    ("count = 1\nmain = { size = 1, tags = ['a', 'a'] }", "main: expected different tags"),
    ("count = 1" + "\n[[parts]]\nsize = 1" * 3, "parts[2].size: expected at most two, got 3"),
]


@pytest.mark.parametrize(("text", "message"), FAULTS)
def test_every_fault_has_its_place(text: str, message: str) -> None:
    with pytest.raises(ValueError) as caught:
        make(text)
    found = str(caught.value)
    assert found.startswith(f"a.toml: {message}")
    assert found == f"a.toml: {message}" or message.endswith(",")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a = 1\nb = x", "a.toml:2:5: Invalid value"),
        ("a = 1\na = 2\n", "a.toml:2:6: Cannot overwrite a value"),
        ("a = 1\nb = [1,\n\n", "a.toml:2: Invalid value (at the end of the file)"),
        ("a = " + "9" * 5000, "a.toml: Exceeds the limit"),
    ],
)
def test_what_is_no_toml(text: str, message: str) -> None:
    with pytest.raises(ValueError) as caught:
        parse(text, "a.toml")
    assert str(caught.value).startswith(message)


def test_files_are_utf_8_with_or_without_a_mark(tmp_path: Path) -> None:
    file = tmp_path / "a.toml"
    for encoding in ("utf-8", "utf-8-sig"):
        file.write_text('a = "Möwe"\n', encoding)
        assert parse(read(file), "a.toml") == {"a": "Möwe"}
    file.write_bytes('# one\na = "Möwe"\n'.encode("latin-1"))
    with pytest.raises(ValueError, match=r"^a\.toml:2: expected UTF-8 text: invalid"):
        read(file)


def test_near() -> None:
    assert near("dron", ("ship", "drone")) == " (did you mean 'drone'?)"
    assert near("submarine", ("ship", "drone")) == ""
