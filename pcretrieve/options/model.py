"""The base class of all options, and the types that several of them have."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from pcretrieve.errors import OptionError

__all__ = ["Count", "Length", "Options", "Share"]

Share = Annotated[float, Field(ge=0, le=1)]
Length = Annotated[float, Field(ge=0, lt=1)]
Count = Annotated[int, Field(ge=1)]


class Options(BaseModel):
    """Immutable parameters with descriptions, validated when an object is made.

    Raises
    ------
    OptionError
        If a value is invalid, or there is no option of that name.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, use_attribute_docstrings=True)

    def __init__(self, **values: Any) -> None:
        try:
            super().__init__(**values)
        except ValidationError as error:
            raise OptionError(_explain(error)) from error


# How pydantic names a type that it tried, in the location of an error of an option with several types.
TYPES_TRIED = (
    "literal['auto','sphere','free']",
    "literal['auto']",
    "literal['none']",
    "constrained-int",
    "constrained-float",
    "tuple[",
)


def _explain(error: ValidationError) -> str:
    """What must hold and what was given, one clause for each invalid option."""
    clauses = []
    for problem in error.errors():
        name = ".".join(str(part) for part in problem["loc"] if not str(part).startswith(TYPES_TRIED))
        cause = problem.get("ctx", {}).get("error")
        if isinstance(cause, OptionError) and name:
            # The message of a table in a table begins with the name of the inner one.
            inner = cause.message.removeprefix("in [")
            clauses.append(f"in [{name}{'], ' if inner == cause.message else '.'}{inner}")
        elif problem["type"] == "value_error":
            clauses.append(f"{name}: {cause}" if name else str(cause))
        elif problem["type"] == "extra_forbidden":
            clauses.append(f"there is no option {name!r}; `pcretrieve options` lists them all")
        else:
            clauses.append(
                f"{name}: {problem['msg'][0].lower()}{problem['msg'][1:]}, got {problem['input']!r}"
            )
    return "; ".join(clauses)
