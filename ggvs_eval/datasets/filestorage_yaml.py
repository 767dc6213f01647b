"""The part of OpenCV's YAML and XML that camera files are written in, read without OpenCV.

cv2.FileStorage ends the process on some damaged files: deep nesting overflows its stack, and about
one mutation in a thousand makes it abort. Nothing here recurses, follows an anchor or allocates by
what a file claims.
"""

import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from ggvs_eval.arrays import Array
from ggvs_eval.errors import CaptureError
from ggvs_eval.files.plain import comma_hint, read_plain_text, why_unread

LARGEST_FILE_BYTES = 1 << 22
# OpenCV's letters of element types; two or more channels per element do not occur in camera files.
ELEMENT_TYPES = "ucwsifdhlLIbB"
ENTRY = re.compile(r"""(["']?)([^\s"'\[\]{}#%:-][^\s"'\[\]{}:]*)\1[ \t]*:(?:[ \t]+(.*))?""")
FIELD = re.compile(r"(rows|cols|dt|data)[ \t]*:[ \t]*(\[[^\[\]]*\]|[^\s\[\]]+)")

# A nested list of numbers, as OpenCV writes vectors and PyYAML writes arrays, in brackets or with
# one number a line.
PLAIN_NUMBER = re.compile(r"[-+.]*\d[-+.\deE]*")
PLAIN_NUMBERS = re.compile(rf"(?:[\s\[\],]|-(?=[ \t\n])|{PLAIN_NUMBER.pattern}(?=[\s\],]|$))+")


class FileStorageYaml:
    """Numbers, matrices and sequences of texts by their key; every surprise is a `CaptureError`.

    Args:
        is_plain: whether YAML without OpenCV's first line is read too, as ROS writes it.
    """

    def __init__(self, path: Path, is_plain: bool = False) -> None:
        self.path = path
        self.entries: dict[str, str] = {}
        text = read_camera_text(path).lstrip("\ufeff")
        lines = text.splitlines()
        if text.lstrip().startswith("<"):
            self._read_xml(text)
        elif lines and lines[0].startswith(("%YAML:1.0", "%YAML 1.")):
            self._split(lines[1:])
        elif is_plain and lines and not lines[0].startswith("%"):
            self._split(lines)
        else:
            raise self._refused(
                "OpenCV YAML, which begins with %YAML:1.0",
                repr(lines[0][:40]) if lines else "no line",
            )

    def texts(self, key: str) -> list[str]:
        """Return a sequence of texts; empty if it is absent or something else."""
        value = self.entries.get(key, "").strip()
        if value.startswith("[") and value.endswith("]"):
            items = value[1:-1].split(",")
        else:
            lines = [line.strip() for line in value.splitlines()]
            items = (
                [line[1:] for line in lines] if all(line.startswith("- ") for line in lines) else []
            )
        return [_unquoted(item) for item in items]

    def has(self, key: str) -> bool:
        """Return whether there is such an entry."""
        return key in self.entries

    def text(self, key: str) -> str:
        """Return a text without its quotes; empty if it is absent."""
        return _unquoted(self.entries.get(key, ""))

    def number(self, key: str) -> float | None:
        """Return a positive number; None if it is absent."""
        if not self.has(key):
            return None
        value = _number(self.entries[key])
        if not 0 < value < 1e9:
            raise self._refused(
                f"a positive number {key}",
                f"{self.entries[key] or 'nothing'}{comma_hint(self.entries[key])}",
            )
        return value

    def matrix(self, key: str, shape: tuple[int, int] | None) -> Array:
        """Return a matrix of finite numbers of this shape or its transpose.

        Of any shape if None.
        """
        if not self.has(key):
            raise self._refused(f"an entry {key}", "none")
        if PLAIN_NUMBERS.fullmatch(self.entries[key]):
            items = PLAIN_NUMBER.findall(self.entries[key])
            rows, columns = shape or (len(items), 1)
        else:
            rows, columns, items = self._fields(key)
        if len(items) != rows * columns or not items:
            raise self._refused(f"{rows} x {columns} numbers in {key}", f"{len(items)}")
        if shape is not None and len(items) != shape[0] * shape[1]:
            raise self._refused(f"{shape[0]} x {shape[1]} numbers in {key}", f"{rows} x {columns}")
        matrix = np.array([_number(item) for item in items])
        if not np.isfinite(matrix).all():
            raise self._refused(
                f"finite numbers in {key}", items[int(np.flatnonzero(~np.isfinite(matrix))[0])]
            )
        return matrix.reshape(shape or (rows, columns))

    def _fields(self, key: str) -> tuple[int, int, list[str]]:
        """Return rows, columns and the numbers of a matrix, as texts."""
        value = self.entries[key]
        fields = dict(FIELD.findall(value))
        is_matrix = (value.startswith("!!opencv-matrix") and "dt" in fields) or value.startswith(
            "rows"
        )
        if (
            not is_matrix
            or not {"rows", "cols", "data"} <= fields.keys()
            or not fields["data"].startswith("[")
        ):
            raise self._refused(
                f"!!opencv-matrix with rows, cols, dt and data in {key}", value or "nothing"
            )
        if _unquoted(fields.get("dt", "d")) not in ELEMENT_TYPES:
            raise self._refused(
                f"one number per element in {key}, such as dt: d", f"dt: {fields['dt']}"
            )
        size = f"{fields['rows']} x {fields['cols']}"
        if not fields["rows"].isdecimal() or not fields["cols"].isdecimal() or len(size) > 12:
            raise self._refused(f"rows and cols of {key}", size)
        items = fields["data"].strip("[]").split(",")
        return int(fields["rows"]), int(fields["cols"]), [item for item in items if item.strip()]

    def _split(self, lines: list[str]) -> None:
        """Cut the file at the lines that begin a key.

        What is indented, or continues with a list, belongs to the key before.
        """
        bodies: dict[str, list[str]] = {}
        body: list[str] | None = None
        for line in lines:
            if not line.strip() or line.startswith(("#", "---", "...")):
                continue
            match = ENTRY.fullmatch(line.rstrip())
            if match and match[2] in bodies:
                raise self._refused("every key once", f"{match[2]} twice")
            if match:
                body = bodies[match[2]] = [(match[3] or "").strip()]
            elif body is None or not line.startswith((" ", "\t", "-", "]")):
                raise self._refused("lines of the form 'key: value'", repr(line[:60]))
            else:
                body.append(line)
        self.entries = {key: "\n".join(body).strip() for key, body in bodies.items()}

    def _read_xml(self, text: str) -> None:
        """Read the entries of an XML file as the YAML of the same content has them."""
        for element in parse_xml(self.path, text, "the XML of cv2.FileStorage"):
            words = " ".join("".join(element.itertext()).split())
            parts = {part.tag: " ".join((part.text or "").split()) for part in element}
            if element.get("type_id") == "opencv-matrix":
                data = ", ".join(parts.get("data", "").split())
                shape = "".join(
                    f"{key}: {parts[key]}\n" for key in ("rows", "cols", "dt") if parts.get(key)
                )
                self.entries[element.tag] = f"!!opencv-matrix\n{shape}data: [{data}]"
            elif words.count('"') > 2 or "_" in parts:  # a sequence of texts
                items = re.findall(r'"([^"]*)"', words) or [part.text or "" for part in element]
                self.entries[element.tag] = f"[{', '.join(items)}]"
            else:
                self.entries[element.tag] = words

    def _refused(self, form: str, content: str) -> CaptureError:
        return refused(self.path, form, content)


def parse_xml(path: Path, text: str, form: str) -> ElementTree.Element:
    """Return the root of an XML text without declarations."""
    try:
        if "<!" in text.replace("<!--", ""):
            raise refused(path, "XML without declarations", "one that begins with <!")
        return ElementTree.fromstring(text.encode())
    except (ElementTree.ParseError, UnicodeError, LookupError, ValueError, RecursionError) as error:
        raise refused(path, form, str(error)) from error


def refused(path: Path, form: str, content: str) -> CaptureError:
    """Return the error of a camera file that holds something else than was wanted."""
    return CaptureError(
        f"{path}: wanted {form}, got {' '.join(content.split())[:160]}; restore or export the file "
        f"again"
    )


def _number(text: str) -> float:
    """Return a number as OpenCV writes it, NaN if the text is none: ``1.``, ``-.Inf``."""
    plain = re.fullmatch(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?", text.strip())
    return float(plain[0]) if plain else float("nan")


def _unquoted(text: str) -> str:
    stripped = text.strip()
    return (
        stripped[1:-1]
        if len(stripped) > 1 and stripped[0] in "\"'" and stripped[-1] == stripped[0]
        else stripped
    )


def read_camera_text(path: Path, form: str = "a camera file") -> str:
    """Return the text of a camera file, which is not empty."""
    try:
        text = read_plain_text(path, LARGEST_FILE_BYTES)
    except OSError as error:
        raise CaptureError(f"{path}: wanted {form}, got {why_unread(error)}; restore it") from error
    except UnicodeDecodeError as error:
        raise CaptureError(
            f"{path}: wanted a text file, got bytes that are no UTF-8 ({error.reason}); restore it"
        ) from error
    if not text:
        raise CaptureError(f"{path}: wanted {form}, got an empty one; restore it")
    return text
