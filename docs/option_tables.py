"""Write options.md, the tables of all options, from their texts in pcretrieve: docs/option_tables.py.

tests/test_documents.py compares the page with what this would write.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from pcretrieve.options import PipelineOptions, describe_options

PAGE = Path(__file__).with_name("options.md")

HEAD = """\
# Options

All options with their defaults. `docs/option_tables.py` writes this page from the texts that `pcretrieve lab
options` prints: change these in `pcretrieve/options/tables.py`. `--config` takes a TOML file with some:

```toml
# mine.toml
[signature]
size_weight = 6.0
```
"""

OPTION = re.compile(r"(?:# )?(\w+) =(?: (.+))?")


def page() -> str:
    """The whole page."""
    return HEAD + "".join(f"\n{line}" for line in _lines()) + "\n"


def _lines() -> Iterator[str]:
    said: list[str] = []
    for line in describe_options(PipelineOptions()).splitlines():
        table = re.fullmatch(r"\[(\w+)\]", line)
        option = OPTION.fullmatch(line)
        if table:
            yield from (f"## `[{table[1]}]`", "", " ".join(said), "")
            yield from ("| Option | Default | Meaning |", "|---|---|---|")
            said = []
        elif option:
            default = "none" if option[2] is None else f"`{option[2]}`"
            meaning = " ".join(said).replace("|", "\\|").replace("<", "&lt;")
            yield f"| `{option[1]}` | {default} | {meaning} |"
            said = []
        elif text := line.removeprefix("#").strip():
            said.append(text)
        elif not line:
            yield ""


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
