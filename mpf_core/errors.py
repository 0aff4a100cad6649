"""Every failure that a caller can meet, as one tree.

    MPFError
    ├── InputError                 the caller's data: exit code 2, HTTP 4xx
    │   ├── FormatError            the bytes are not the file they claim to be (see mpf_core.cloud)
    │   ├── CloudError             the file is sound, the points are not enough
    │   ├── FieldError             the file is not a fitted field that can be used
    │   │   ├── FieldFormat
    │   │   └── FieldVersion
    │   ├── TileError              the file is not a part of a split cloud that can be used
    │   │   ├── TileFormat
    │   │   └── TileVersion
    │   └── OptionsError           an option is unknown, out of range or contradicts another
    │       └── OutsideBox
    ├── FitError                   the fit could not end well: exit code 3, HTTP job `failed`
    │   ├── Diverged
    │   ├── OutOfTime
    │   └── CheckpointError
    ├── SurfaceError               there is no surface to take from the field
    │   ├── NoSurface
    │   └── ResolutionTooHigh
    └── Cancelled                  the caller asked to stop: exit code 130, HTTP job `cancelled`

Each class has a stable `code`; each instance a `message` for a person, `where` in the input the
cause lies (line, byte, field) and `advice`, one sentence on what to do about it.
"""

from __future__ import annotations

from typing import ClassVar


class MPFError(Exception):
    """Base of all errors; `str(error)` is one sentence fit to show to a user."""

    code: ClassVar[str] = "mpf.error"

    def __init__(self, message: str, *, where: str | None = None, advice: str | None = None):
        super().__init__(message)
        self.message = message
        self.where = where
        self.advice = advice

    def __str__(self) -> str:
        place = f" ({self.where})" if self.where else ""
        advice = f" {self.advice}" if self.advice else ""
        return f"{self.message}{place}.{advice}"

    def as_dict(self) -> dict[str, str | None]:
        """The error as JSON carries it: `code`, `message`, `where`, `advice`."""
        return {
            "code": self.code,
            "message": self.message,
            "where": self.where,
            "advice": self.advice,
        }


class InputError(MPFError):
    """The caller's data cannot be used as it is."""

    code = "input"


class FormatError(InputError):
    """The bytes are not a point cloud in a format that is read."""

    code = "format"


class CloudError(InputError):
    """The file is sound but its points do not make a surface."""

    code = "cloud"


class NotFinite(CloudError):
    """NaN or infinite coordinates."""

    code = "cloud.not_finite"


class TooSmall(CloudError):
    """Fewer distinct points than the neighbourhoods need."""

    code = "cloud.too_small"


class TooLarge(CloudError):
    """More points than the limit."""

    code = "cloud.too_large"


class Collinear(CloudError):
    """All points on one line."""

    code = "cloud.collinear"


class FieldError(InputError):
    """The file is not a fitted field that can be used."""

    code = "field"


class FieldFormat(FieldError):
    """The file is not a fitted field, or a damaged one."""

    code = "field.format"


class FieldVersion(FieldError):
    """The field was written by later software."""

    code = "field.version"


class TileError(InputError):
    """The file is not a part of a split cloud that can be used."""

    code = "tile"


class TileFormat(TileError):
    """The file is not a plan or a tile, or a damaged one."""

    code = "tile.format"


class TileVersion(TileError):
    """The plan or tile was written by later software."""

    code = "tile.version"


class OptionsError(InputError):
    """An option is unknown, out of range or contradicts another."""

    code = "options.invalid"


class OutsideBox(OptionsError):
    """A slice lies outside the box of the field."""

    code = "options.outside_box"


class FitError(MPFError):
    """The fit could not end well."""

    code = "fit"


class Diverged(FitError):
    """The loss grew without bound and retries at lower rates did not help."""

    code = "fit.diverged"


class OutOfTime(FitError):
    """The time budget ended before there was a surface."""

    code = "fit.out_of_time"


class CheckpointError(FitError):
    """A checkpoint is damaged or of another fit; the fit begins anew."""

    code = "fit.checkpoint"


class SurfaceError(MPFError):
    """No mesh can be taken from the field."""

    code = "surface"


class NoSurface(SurfaceError):
    """The field has no zero level inside the box."""

    code = "surface.none"


class ResolutionTooHigh(SurfaceError):
    """The grid asked for does not fit into the memory limit."""

    code = "surface.resolution_too_high"


class Cancelled(MPFError):
    """The caller's `cancel` said stop."""

    code = "cancelled"
