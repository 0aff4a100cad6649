"""What the reader made of an input, as HTTP shows it: `mpf_core.cloud.inspection.Inspection`."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field


class ColumnOut(BaseModel):
    """One column or property of the file."""

    model_config = ConfigDict(title="Column")

    name: str = Field(description="As the file calls it, or `column 4` where it has no name.")
    meaning: str = Field(description="What it was taken for.")


class DensityOut(BaseModel):
    """How densely the samples lie, in input units."""

    model_config = ConfigDict(title="Density")

    spacing: float = Field(description="Gap between samples.")
    sparse: float = Field(description="95 % quantile of the distance to the sixth neighbour.")
    dense: float = Field(description="5 % quantile of the same.")
    normal_reliability: float = Field(
        description="Share of samples whose fitted normal agrees with its neighbours'."
    )


class PreparationOut(BaseModel):
    """What preparing the points for a fit does to them."""

    model_config = ConfigDict(title="Preparation")

    received: int
    not_finite_dropped: int
    duplicates_merged: int
    outliers_removed: int
    kept: int
    density: DensityOut | None
    steps: list[str]


class InspectionOut(BaseModel):
    """A file as the reader understood it; `mpf inspect --json` prints the same."""

    model_config = ConfigDict(title="Inspection")

    file: str
    bytes: int
    format: str = Field(description="ply or xyz.")
    dialect: str
    points: int = Field(description="Rows in the file.")
    columns: list[ColumnOut]
    normals: bool
    colors: bool
    low: tuple[float, float, float] | None = Field(
        description="Corner of the box of the finite points, input units."
    )
    high: tuple[float, float, float] | None
    spacing: float | None = Field(description="None if no surface can be made of the points.")
    preparation: PreparationOut | None = Field(description="None if it refuses the points.")
    notes: list[str]
    warnings: list[str]
