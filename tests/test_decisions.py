"""docs/decisions.md has a row for each decision that a comment names, and each row has a name in the code."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
TABLE = (ROOT / "docs" / "decisions.md").read_text(encoding="utf-8")
KEYS = set(re.findall(r"^\| `(\w+)`", TABLE, re.MULTILINE))
SOURCES = [path.read_text(encoding="utf-8") for path in sorted((ROOT / "pcretrieve").rglob("*.py"))]


def test_every_decision_that_a_comment_names_has_a_row() -> None:
    prose = [re.sub(r"\s*\n\s*(#:? )?", " ", source) for source in SOURCES]
    named = {key for text in prose for key in re.findall(r"docs/decisions\.md, (\w+)", text)}
    assert named
    assert named <= KEYS


def test_every_row_is_of_a_name_in_the_code() -> None:
    words = {word for source in SOURCES for word in re.findall(r"\w+", source)}
    assert words >= KEYS
