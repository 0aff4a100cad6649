"""Every way in which a file can fail to be a point cloud: one class per cause.

    FormatError
    ├── InputEmpty, InputUnreadable, InputTooLarge, FormatUnknown       any file
    ├── PlyError                                                        PLY, header first
    │   ├── PlyHeaderTruncated, PlyHeaderTooLong, PlyHeaderLine
    │   ├── PlyFormatMissing, PlyFormatUnsupported
    │   ├── PlyElementCount, PlyElementDuplicate
    │   ├── PlyPropertyType, PlyPropertyDuplicate
    │   ├── PlyVertexMissing, PlyVertexCoordinates
    │   └── PlyCountMismatch, PlyTooManyRows, PlyListLength, PlyRowColumns, PlyRowNumber
    └── XyzError                                                        text rows
        ├── XyzEncoding, XyzLineTooLong, XyzNoPoints
        ├── XyzHeaderColumns, XyzColumnsTooFew, XyzColumnsTooMany
        └── XyzCountMismatch, XyzRowColumns, XyzRowNumber
    CloudError (see mpf_core.errors)
    └── NoExtent

`where` is a line for text and a byte offset for binary data; both count in the file as it was
given, lines from 1 and bytes from 0.
"""

from __future__ import annotations

from mpf_core.errors import CloudError, FormatError, MPFError


class InputEmpty(FormatError):
    """The file has no bytes."""

    code = "input.empty"


class InputUnreadable(FormatError):
    """The path is missing, is not a regular file or may not be read."""

    code = "input.unreadable"


class InputTooLarge(FormatError):
    """The file has more bytes than the limit."""

    code = "input.too_large"


class FormatUnknown(FormatError):
    """The content is neither PLY nor rows of numbers."""

    code = "input.format_unknown"


class PlyError(FormatError):
    """The file starts as PLY and then breaks the format."""

    code = "ply"


class PlyHeaderTruncated(PlyError):
    """The header has no `end_header`."""

    code = "ply.header.truncated"


class PlyHeaderTooLong(PlyError):
    """The header is longer than any honest one."""

    code = "ply.header.too_long"


class PlyHeaderLine(PlyError):
    """A header line is not one of PLY's, or has words missing or left over."""

    code = "ply.header.line"


class PlyFormatMissing(PlyError):
    """The `format` line is missing or does not come first."""

    code = "ply.format.missing"


class PlyFormatUnsupported(PlyError):
    """The `format` line names an encoding or version that does not exist."""

    code = "ply.format.unsupported"


class PlyElementCount(PlyError):
    """An element's count is not a plain whole number."""

    code = "ply.element.count"


class PlyElementDuplicate(PlyError):
    """Two elements have the same name."""

    code = "ply.element.duplicate"


class PlyPropertyType(PlyError):
    """A property's type is not one of PLY's."""

    code = "ply.property.type"


class PlyPropertyDuplicate(PlyError):
    """A coordinate is declared twice."""

    code = "ply.property.duplicate"


class PlyVertexMissing(PlyError):
    """There is no element that holds points."""

    code = "ply.vertex.missing"


class PlyVertexCoordinates(PlyError):
    """The vertices lack x, y or z, or hold them as lists."""

    code = "ply.vertex.coordinates"


class PlyCountMismatch(PlyError):
    """The header declares more than the file holds."""

    code = "ply.count.mismatch"


class PlyTooManyRows(PlyError):
    """The elements beside the vertices declare more rows than the limit."""

    code = "ply.rows.too_many"


class PlyListLength(PlyError):
    """A list's length is negative or not a whole number."""

    code = "ply.list.length"


class PlyRowColumns(PlyError):
    """A text row has more or fewer values than its element has properties."""

    code = "ply.row.columns"


class PlyRowNumber(PlyError):
    """A value in a text row is not a number."""

    code = "ply.row.number"


class XyzError(FormatError):
    """The file looks like rows of numbers and then breaks that."""

    code = "xyz"


class XyzEncoding(XyzError):
    """The text is in an encoding other than ASCII or UTF-8."""

    code = "xyz.encoding"


class XyzLineTooLong(XyzError):
    """A line is longer than any honest row."""

    code = "xyz.line.too_long"


class XyzNoPoints(XyzError):
    """There are comments or a header, but no rows."""

    code = "xyz.no_points"


class XyzHeaderColumns(XyzError):
    """The header names other columns than the rows have, or no x, y and z."""

    code = "xyz.header.columns"


class XyzColumnsTooFew(XyzError):
    """The rows have fewer than three columns."""

    code = "xyz.columns.too_few"


class XyzColumnsTooMany(XyzError):
    """The rows have more columns than the limit."""

    code = "xyz.columns.too_many"


class XyzCountMismatch(XyzError):
    """The leading count is more than the number of rows."""

    code = "xyz.count.mismatch"


class XyzRowColumns(XyzError):
    """A row has more or fewer columns than the others."""

    code = "xyz.row.columns"


class XyzRowNumber(XyzError):
    """A value in a row is not a number."""

    code = "xyz.row.number"


class NoExtent(CloudError):
    """The cloud is smaller than double precision can carry."""

    code = "cloud.no_extent"


def error_codes() -> dict[str, str]:
    """The closed list of what reading and preparing can answer: code → one line, sorted."""
    found: dict[str, str] = {}
    waiting: list[type[MPFError]] = [FormatError, CloudError]
    while waiting:
        kind = waiting.pop()
        below = kind.__subclasses__()
        waiting.extend(below)
        if not below:  # inner classes group causes; only leaves are raised
            found[kind.code] = (kind.__doc__ or "").splitlines()[0]
    return dict(sorted(found.items()))
