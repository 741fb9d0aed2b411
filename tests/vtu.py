"""A reader of VTK XML unstructured grids, written from the format's description: for tests of what is written."""

import base64
import xml.etree.ElementTree as ElementTree
import zlib

import numpy as np


def read_array(node):
    """One DataArray by the book: VTK file formats, compressed binary with a header of UInt64."""
    text = node.text.strip()
    size = np.dtype("<u8").itemsize
    blocks = int(np.frombuffer(base64.b64decode(text[:12]), "<u8", 1)[0])
    header_chars = 4 * -(-(3 + blocks) * size // 3)
    header = np.frombuffer(base64.b64decode(text[:header_chars]), "<u8")
    assert header[0] == blocks and len(header) == 3 + blocks and header[2] < header[1]
    data, raw, start = base64.b64decode(text[header_chars:], validate=True), b"", 0
    for i, length in enumerate(header[3:]):
        block = zlib.decompress(data[start : start + int(length)])
        last = i == blocks - 1 and header[2] > 0
        assert len(block) == (header[2] if last else header[1])
        raw, start = raw + block, start + int(length)
    assert start == len(data)
    kind, name = node.attrib["type"], node.attrib["Name"]
    values = np.frombuffer(raw, {"Float64": "<f8", "Float32": "<f4", "Int64": "<i8", "Int8": "i1", "UInt8": "u1"}[kind])
    components = int(node.attrib.get("NumberOfComponents", 1))
    return name, values.reshape(-1, components) if components > 1 else values


def read_vtu(path):
    root = ElementTree.parse(path).getroot()
    assert root.attrib["type"] == "UnstructuredGrid" and root.attrib["header_type"] == "UInt64"
    piece = root.find("UnstructuredGrid/Piece")
    sections = {name: dict(map(read_array, piece.find(name))) for name in ("Points", "Cells", "PointData", "CellData")}
    counts = {name: int(piece.attrib[name]) for name in ("NumberOfPoints", "NumberOfCells")}
    field = root.find("UnstructuredGrid/FieldData")
    return sections, counts, {} if field is None else dict(map(read_array, field))
