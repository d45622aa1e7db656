"""The syntax of VRML97 [1]_: text → nodes with fields.

The types of fields are not declared in a file. A field is read by its first word: a bracket begins a list, a
word before a brace a node, a number a row of numbers.

References
----------
.. [1] ISO/IEC 14772-1:1997, "The Virtual Reality Modeling Language", part 1.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from pcretrieve.arrays import FloatArray
from pcretrieve.errors import ScanReadError

__all__ = ["Node", "parse_nodes"]

BLANK = re.compile(r"(?:[\s,]+|#[^\n]*)*")
STRING = re.compile(r'"(?:[^"\\]|\\.)*"', re.DOTALL)
WORD = re.compile(r'[^\s,#"{}\[\]]+')
COMMENT = re.compile(r"#[^\n]*")
# Most nodes within each other; the files of modellers have tens.
MOST_NESTED = 100


@dataclass(slots=True)
class Node:
    """A node of the scene."""

    kind: str
    name: str = ""
    fields: dict[str, Any] = field(default_factory=dict)

    def nodes(self) -> list[Node]:
        """All nodes in its fields, in their order."""
        held = (value if isinstance(value, list) else [value] for value in self.fields.values())
        return [node for values in held for node in values if isinstance(node, Node)]


def parse_nodes(text: str) -> list[Node]:
    """Parse the statements of a file."""
    parser = _Parser(text)
    nodes = []
    while (word := parser.word()) is not None:
        if word == "ROUTE":
            for _ in range(3):
                parser.word()
        else:
            nodes.append(parser.node(word, 0))
    return nodes


class _Parser:
    """A position in the text, and the nodes that were named before it."""

    def __init__(self, text: str) -> None:
        self._text = text
        self._at = 0
        self._named: dict[str, Node] = {}

    def word(self) -> str | None:
        """The next word, bracket, brace or string; None at the end."""
        found = self.peek()
        self._at += len(found or "")
        return found

    def peek(self) -> str | None:
        """The same without going on."""
        blank = BLANK.match(self._text, self._at)
        self._at = blank.end() if blank else self._at
        if self._at >= len(self._text):
            return None
        first = self._text[self._at]
        if first in "{}[]":
            return first
        found = (STRING if first == '"' else WORD).match(self._text, self._at)
        if found is None:
            raise ScanReadError("a string has no end")
        return found[0]

    def node(self, kind: str, depth: int) -> Node:
        """The node that begins with a word."""
        if depth > MOST_NESTED:
            raise ScanReadError(f"more than {MOST_NESTED} nodes lie within each other")
        if kind in ("PROTO", "EXTERNPROTO"):
            raise ScanReadError("it declares prototypes, which are not read: export it plainly")
        if kind == "USE":
            name = self.word() or ""
            if name not in self._named:
                raise ScanReadError(f"the node {name[:40]!r} is used before it is defined")
            return self._named[name]
        name = ""
        if kind == "DEF":
            name, kind = self.word() or "", self.word() or ""
        if self.word() != "{":
            raise ScanReadError(f"there is no brace behind {kind[:40]!r}")
        made = Node(kind, name)
        while (word := self.word()) != "}":
            if word is None:
                raise ScanReadError(f"a node {kind[:40]} has no end")
            if word == "ROUTE":
                for _ in range(3):
                    self.word()
            else:
                made.fields[word] = self._value(depth)
        if name:
            self._named[name] = made
        return made

    def _value(self, depth: int) -> Any:
        word = self.word()
        if word is None:
            raise ScanReadError("a field has no value")
        if word == "[":
            return self._list(depth)
        if word in ("DEF", "USE") or self.peek() == "{":
            return self.node(word, depth + 1)
        numbers = []
        while (number := _number(word)) is not None:
            numbers.append(number)
            if (word := self.peek()) is None or _number(word) is None:
                return np.array(numbers)
            self.word()
        return word

    def _list(self, depth: int) -> Any:
        end = self._text.find("]", self._at)
        if end < 0:
            raise ScanReadError("a list has no end")
        inner = self._text[self._at : end]
        # Numbers, which may be millions, are not read word by word.
        if "{" not in inner and (numbers := _numbers(inner)) is not None:
            self._at = end + 1
            return numbers
        values: list[Any] = []
        while (word := self.word()) != "]":
            if word is None:
                raise ScanReadError("a list has no end")
            values.append(word if word.startswith('"') else self.node(word, depth + 1))
        return values


def _number(word: str) -> float | None:
    try:
        return float(word)
    except ValueError:
        return None


def _numbers(text: str) -> FloatArray | None:
    try:
        return np.array(COMMENT.sub("", text).replace(",", " ").split(), dtype=np.float64)
    except ValueError:
        return None
