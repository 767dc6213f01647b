"""TOML tables as frozen dataclasses: every mismatch is an error that names file, key and fix."""

import dataclasses
import re
import sys
import tomllib
import types
import typing
from pathlib import Path
from typing import Any, Literal, TypeVar

from ggvs_eval.errors import GgvsError, did_you_mean
from ggvs_eval.files.plain import LARGEST_TOML, read_plain_text, why_unread

Table = TypeVar("Table")
LONG_KEY = re.compile(r"""(?<![\w"'-])(?:[\w"'-]+[ \t]*\.[ \t]*){64}""")


def parse_toml(text: str, file: str, error: type[GgvsError]) -> dict[str, Any]:
    """Return the values of a TOML text.

    Raises:
        error: not TOML.
    """
    try:
        return load_toml(text)
    except (ValueError, RecursionError) as reason:
        raise error(
            f"{file}: not valid TOML: {reason}; correct it, or restore a complete copy"
        ) from None


def load_toml(text: str) -> dict[str, Any]:
    """`tomllib.loads` for untrusted texts.

    Raises:
        ValueError: not TOML, or keys of more parts than the parser, quadratic in them, can read in
            seconds.
        RecursionError: nested too deep.
    """
    if LONG_KEY.search(text):
        raise ValueError("a key of more than 64 parts")
    return tomllib.loads(text)


def read_toml(path: Path, error: type[GgvsError]) -> dict[str, Any]:
    """Return the values of a TOML file.

    Raises:
        error: absent, not text, or not TOML.
    """
    try:
        text = read_plain_text(path, LARGEST_TOML)
    except (OSError, UnicodeDecodeError) as error_of_file:
        reason = why_unread(error_of_file) if isinstance(error_of_file, OSError) else error_of_file
        raise error(
            f"{path}: wanted a TOML file, got: {reason}; restore or write it"
        ) from error_of_file
    return parse_toml(text, str(path), error)


def build_table(
    kind: type[Table], values: dict[str, Any], file: str, section: str, error: type[GgvsError]
) -> Table:
    """Turn a TOML table into a dataclass, checking names and types.

    Args:
        kind: a dataclass; its fields may be bool, int, float (finite), str, Literal, tuple[X, ...],
            X | None and dataclasses.
        error: raised for unknown, missing and mistyped keys; the message has all of them, with the
            nearest known ones.

    Examples:
        >>> from ggvs_eval.errors import ProtocolError
        >>> from ggvs_eval.protocol import Frames
        >>> build_table(Frames, {"start": 3, "count": 2}, "mine.toml", "frames.", ProtocolError)
        Frames(start=3, count=2)
        >>> build_table(Frames, {"strat": 3}, "mine.toml", "frames.", ProtocolError)
        Traceback (most recent call last):
        ggvs_eval.errors.ProtocolError: mine.toml: unknown key frames.strat; ... frames.start?
    """
    faults: list[str] = []
    table = _table(kind, values, section, faults)
    if faults:
        raise error(f"{file}: {'; also '.join(faults)}")
    return table


def key_of(name: str) -> str:
    """The key of a field in a file: its name, without the underscore that distinguishes it from a
    Python keyword (``as_``).
    """
    return name.removesuffix("_")


def _table(kind: type[Table], values: dict[str, Any], section: str, faults: list[str]) -> Table:
    """Return the table as far as it can be read; what is wrong with it is added to `faults`."""
    fields = {key_of(field.name): field for field in dataclasses.fields(kind)}  # type: ignore[arg-type]
    hints = typing.get_type_hints(kind)
    faults += [
        f"unknown key {section}{key}{did_you_mean(key, fields, cutoff=0.0, prefix=section)}"
        for key in values
        if key not in fields
    ]
    defaults = (dataclasses.MISSING, dataclasses.MISSING)
    required = [
        name for name, field in fields.items() if (field.default, field.default_factory) == defaults
    ]
    if missing := [f"{section}{name}" for name in required if name not in values]:
        faults.append(
            f"missing key {', '.join(missing)}; add it, the known keys are {', '.join(fields)}"
        )
    entries = {key: value for key, value in values.items() if key in fields}
    converted = {
        fields[key].name: _convert(hints[fields[key].name], value, f"{section}{key}", faults)
        for key, value in entries.items()
    }
    return typing.cast(Table, None) if faults else kind(**converted)


def _convert(field_type: Any, value: Any, key: str, faults: list[str]) -> Any:
    origin, arguments = typing.get_origin(field_type), typing.get_args(field_type)
    if origin in (types.UnionType, typing.Union):
        field_type = next(argument for argument in arguments if argument is not types.NoneType)
        return _convert(field_type, value, key, faults)
    if dataclasses.is_dataclass(field_type) and isinstance(value, dict):
        return _table(typing.cast(type, field_type), value, f"{key}.", faults)
    if origin is tuple and isinstance(value, list):
        return tuple(
            _convert(arguments[0], item, f"{key}[{index}]", faults)
            for index, item in enumerate(value)
        )
    if origin is Literal and value in arguments:
        return value
    if field_type is float and type(value) in (int, float) and abs(value) <= sys.float_info.max:
        return float(value)
    if origin is None and type(value) is field_type and field_type is not float:
        return value
    expected = (
        f"one of {', '.join(map(repr, arguments))}" if origin is Literal else _type_name(field_type)
    )
    faults.append(f"{key} must be {expected}, got {value!r:.80}")
    return None


def _type_name(field_type: Any) -> str:
    if typing.get_origin(field_type) is tuple:
        return f"a list of {_type_name(typing.get_args(field_type)[0])}"
    names = {float: "a finite number", int: "a whole number", str: "a text", bool: "true or false"}
    return names.get(
        field_type, "a table" if dataclasses.is_dataclass(field_type) else str(field_type)
    )
