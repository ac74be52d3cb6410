# SPDX-License-Identifier: GPL-3.0-or-later
"""plain_xml(): parses XML from outside and refuses declarations, which could expand a small file to a huge one."""
from pathlib import Path
from xml.etree import ElementTree as ET
from xml.parsers import expat

from .errors import FastGSError
from .reading import read_bytes, reading


def plain_xml(path: Path, limit: int) -> ET.Element:
    """The root of an XML file of at most `limit` bytes; raises FastGSError, also where it declares types or entities."""
    text = read_bytes(path, limit)
    with reading(path, "it is not XML, or is cut short; export it again"):
        _check_plain(path, text)
        return ET.fromstring(text)  # noqa: S314 -- nothing is declared in it


def _check_plain(path: Path, text: bytes) -> None:

    def refuse(*_: object) -> None:
        raise FastGSError(f"{path}: it declares types or entities, which no file of this kind does; export it again.")

    parser = expat.ParserCreate()  # the encoding is known to it alone
    parser.StartDoctypeDeclHandler = parser.EntityDeclHandler = refuse
    parser.Parse(text, True)
