"""Files in a folder: the one list of suffixes, in any case, without the hidden files of operating
systems.
"""

import os
import shlex
import unicodedata
from collections import Counter
from pathlib import Path

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg")
VIDEO_SUFFIXES = (".mp4", ".mov", ".m4v")
UNREAD_PICTURES = (
    ".webp",
    ".tif",
    ".tiff",
    ".bmp",
    ".exr",
    ".hdr",
    ".gif",
    ".avif",
    ".heic",
    ".jxl",
    ".jp2",
    ".ppm",
    ".tga",
)
RAW_VIDEOS = (".h264", ".264", ".h265", ".265", ".hevc")  # streams without times
UNREAD_VIDEOS = (
    ".avi",
    ".mkv",
    ".webm",
    ".mpg",
    ".mpeg",
    ".wmv",
    ".mts",
    ".m2ts",
    ".ts",
    ".flv",
    ".insv",
    ".braw",
    *RAW_VIDEOS,
)
# Of macOS, Windows and network drives; `.DS_Store` and `._NAME` are hidden anyway.
JUNK = {
    "__macosx",
    "thumbs.db",
    "ehthumbs.db",
    "desktop.ini",
    "@eadir",
    "$recycle.bin",
    "system volume information",
}
LISTED = 3


def is_junk(name: str) -> bool:
    """Return whether a name is hidden, or that of a file or folder an operating system makes alone.

    Examples:
        >>> [is_junk(name) for name in ("._0000.png", "Thumbs.db", "__MACOSX", "cam00")]
        [True, True, True, False]
    """
    return name.startswith(".") or name.lower() in JUNK


def list_entries(folder: Path) -> list[Path]:
    """Return the files and folders in a folder by name, junk aside; none if there is no folder."""
    return (
        sorted(entry for entry in folder.iterdir() if not is_junk(entry.name))
        if folder.is_dir()
        else []
    )


def list_files(folder: Path, suffixes: tuple[str, ...]) -> list[Path]:
    """Return the entries of a folder with one of some suffixes, in lower case here and in any on
    disk.
    """
    return [entry for entry in list_entries(folder) if entry.suffix.lower() in suffixes]


def list_images(folder: Path) -> list[Path]:
    """List the images in a folder, by name."""
    return list_files(folder, IMAGE_SUFFIXES)


def list_files_below(
    folder: Path, suffixes: tuple[str, ...] = IMAGE_SUFFIXES, deepest: int = 1000
) -> list[Path]:
    """The files with one of some suffixes in a folder and the folders in it, to a depth, by path,
    junk aside.

    Links to folders are followed, each folder once, so that circles end.
    """
    files, real_folders = [], {folder.resolve()}
    for place, folders, names in os.walk(folder, followlinks=True):
        inner = {name: Path(place, name).resolve() for name in sorted(folders) if not is_junk(name)}
        is_deep = len(Path(place).relative_to(folder).parts) >= deepest
        folders[:] = [
            name for name, real in inner.items() if real not in real_folders and not is_deep
        ]
        real_folders.update(inner.values())
        files += [
            Path(place, name)
            for name in names
            if not is_junk(name) and Path(name).suffix.lower() in suffixes
        ]
    return sorted(files)


def same_name(name: str) -> str:
    """Return a name as names are compared: macOS writes an umlaut as two characters, others as one
    (NFD and NFC).
    """
    return unicodedata.normalize("NFC", name)


def find_below(folder: Path, relative: str) -> Path:
    """Return the file or folder of a relative name, as the disk spells it: umlauts and the suffix's
    case may differ.

    Returns:
        folder / relative if there is none.
    """
    if (folder / relative).exists():
        return folder / relative
    place = folder
    for part in Path(relative).parts:
        place = next(
            (entry for entry in list_entries(place) if _spelling(entry.name) == _spelling(part)),
            place / part,
        )
    return place


def _spelling(name: str) -> tuple[str, str]:
    path = Path(same_name(name))
    return path.stem, path.suffix.lower()


def unread_pictures(folder: Path) -> str:
    """Return the pictures in a folder whose format is not read, and what to do.

    Empty if there are none.
    """
    counts = Counter(file.suffix.lower() for file in list_files(folder, UNREAD_PICTURES))
    listed = " and ".join(f"{count} {suffix}" for suffix, count in counts.most_common())
    linear = (
        "; .exr holds linear light: ffmpeg -i IN.exr -vf "
        "zscale=tin=linear:t=iec61966-2-1,format=rgb24 OUT.png"
    )
    return (
        f"{listed} unsupported pictures: convert them to .png{linear * ('.exr' in counts)}"
        if listed
        else ""
    )


def unread_videos(folder: Path, stems: tuple[str, ...] = ()) -> str:
    """Videos in a folder that are not read, of these stems or any, and the command that converts
    them; empty without.
    """
    spellings = set(map(same_name, stems))
    files = [
        file
        for file in list_files(folder, UNREAD_VIDEOS)
        if not spellings or same_name(file.stem) in spellings
    ]
    if not files:
        return ""
    names = ", ".join(file.name for file in files[:LISTED]) + (
        ", ..." if len(files) > LISTED else ""
    )
    source, timed, copy = (
        shlex.quote(files[0].stem + suffix)
        for suffix in (files[0].suffix, ".mkv", VIDEO_SUFFIXES[0])
    )
    command = f"ffmpeg -i {source} -crf 8 {copy}"
    if files[0].suffix.lower() in RAW_VIDEOS:
        table = (
            f"mkvmerge -o {timed} --timestamps 0:TIMES.txt {source}, then ffmpeg -i {timed} "
            f"-crf 8 {copy}"
        )
        command = f"a stream without times, those of its frames are in a table beside it: {table}"
    return f"{names} {'are' if len(files) > 1 else 'is'} there but not supported: {command}"
