"""How the field is fitted: one group of `Options`. Lengths are normalised ([-1, 1]³)."""

from __future__ import annotations

from dataclasses import dataclass

from mpf_core.option_fields import option

LARGEST = 1e6  # of a weight or a sharpness: larger ones leave single precision nothing else to see


@dataclass(frozen=True)
class FitOptions:
    """How the field is fitted. Defaults are those of `balanced`."""

    max_iterations: int = option(
        3000, "Cap on optimiser steps.", low=1, high=200_000, unit="iterations", expert=False
    )
    time_budget: float = option(
        165.0,
        "Wall-clock cap from the first call to the finished mesh; the surface found so far is "
        "extracted when it runs out.",
        low=1.0,
        high=7 * 86_400.0,
        unit="s",
        expert=False,
    )
    normals: str = option(
        "auto",
        "The normal term: on when PCA normals are measured to be reliable, or forced.",
        choices=("auto", "on", "off"),
        expert=False,
    )
    closed: bool = option(
        False,
        "Start the phase head's last bias at a small negative value, for shapes known to be "
        "closed (section Network Architecture).",
        expert=False,
    )
    denoise: str = option(
        "auto",
        "Project samples onto locally fitted planes when they are measured to scatter about the "
        "surface by as much as their spacing.",
        choices=("auto", "off"),
    )
    outlier_sigma: float | None = option(
        None,
        "Leave out samples whose mean distance to 16 neighbours is more than so many standard "
        "deviations above the mean; all are kept if not given.",
        low=0.1,
        high=100.0,
    )
    analysed: int = option(
        200_000,
        "Samples at most that the start is made from, one of each voxel of larger clouds; a draft "
        "has time for a quarter. The surface terms see all of a clean cloud.",
        low=1000,
        high=240_000,
    )
    warm_start: bool = option(
        True, "Regress r and θ to a classical fit first; without it no CPU budget suffices."
    )
    warm_fraction: float = option(
        0.6,
        "Share of the iterations after which the regression's weight is exactly 0.",
        low=0.0,
        high=0.6,
    )
    width: int = option(256, "Units per layer (the paper's).", low=8, high=1024)
    omega: float | None = option(
        None,
        "First-layer frequency ω₀; by default the higher the closer the samples are, from 45 on.",
        low=1.0,
        high=200.0,
    )
    slow_waves: float = option(
        0.125,
        "Share of the first layer's units that begin with a quarter of ω₀: with fast waves alone, "
        "what is deep inside learns its side a thousand steps late, or not at all.",
        low=0.0,
        high=1.0,
    )
    beta: float = option(50.0, "Start of the learnable phase sharpness β.", low=0.01, high=1000.0)
    composite: str = option(
        "residual",
        "φ = r·P + θ. For ablations: the product r·P, or the phase P alone; θ then has no gradient "
        "near the surface, or no distance.",
        choices=("residual", "product", "phase"),
    )
    softplus_slope: float = option(
        100.0, "Sharpness of the softplus that keeps r ≥ 0.", low=1.0, high=LARGEST
    )
    alpha: float = option(
        100.0,
        "Sharpness α of the align window and of the far-field barrier.",
        low=0.1,
        high=LARGEST,
    )
    surface_points: int = option(
        1536,
        "Cloud samples per step; three for each one of the band fit edges closer than as many.",
        low=16,
        high=200_000,
    )
    near_points: int = option(512, "Band samples per step.", low=16, high=200_000)
    start_points: int = option(
        4096, "Samples per step of the regression to the warm start.", low=16, high=200_000
    )
    far_points: int = option(1024, "Free-space samples per step.", low=16, high=200_000)
    laplacian_points: int = option(
        128, "Points per step at which second derivatives are taken.", low=0, high=200_000
    )
    band_neighbour: int = option(
        50, "Near samples are jittered by the distance to this neighbour.", low=2, high=50
    )
    precision: str = option(
        "auto",
        "Of the hidden layers' products while fitting; auto takes bfloat16 where it is faster "
        "on this processor, where a step then costs half as much.",
        choices=("auto", "float32", "bfloat16"),
    )
    optimizer: str = option(
        "muon",
        "Muon on the square matrices cuts the error by a third at equal time.",
        choices=("adam", "muon"),
    )
    schedule: str = option("cosine", "Decay of the learning rates.", choices=("constant", "cosine"))
    learning_rate: float = option(3e-3, "Adam's rate.", low=1e-7, high=1.0)
    muon_learning_rate: float = option(
        0.01,
        "Muon's rate; 0.02 diverges once the align and Laplacian terms are on.",
        low=1e-6,
        high=1.0,
    )
    terms_rate: float = option(
        0.3,
        "Factor on the rates from where the paper's terms join on: at full rates they lead the "
        "second wall of a shell away before they have formed it, and the more steps there are the "
        "longer they pull at it.",
        low=0.01,
        high=1.0,
    )
    beta_learning_rate: float = option(1e-4, "Adam's rate for β (the paper's).", low=0.0, high=1.0)
    gradient_clip: float = option(
        0.0, "Largest norm of the whole gradient; 0 leaves it alone.", low=0.0, high=LARGEST
    )
    patience: float = option(
        0.15,
        "The best mean of states is kept, and the fit ends when there was no better one for this "
        "share of its iterations; at 0 it runs to its end and the last one is kept.",
        low=0.0,
        high=1.0,
    )
    averaging: float = option(
        0.99,
        "Of the mean of the parameters that is delivered, the share kept in each step since the "
        "paper's terms stand alone: it is off the surface by a tenth less than the last state; at "
        "0 that is delivered.",
        low=0.0,
        high=0.9999,
    )
    align_from: float = option(
        0.3, "Share of the iterations after which the align term is on.", low=0.0, high=1.0
    )
    align_at_folds: bool = option(
        False,
        "Whether the align term counts in full where θ folds, half way between the sides of a thin "
        "wall, and has no direction. It then leaves waves on both: a plate 0.01 thick is twice as "
        "far off. Around open sheets it always does: it keeps their shells from being pierced.",
    )
    weight_zero: float = option(1.0, "Surface data, eq. zero_level.", low=0.0, high=LARGEST)
    weight_align: float = option(0.7, "Gradient alignment, eq. align.", low=0.0, high=LARGEST)
    weight_eik_r: float = option(0.007, "Metric Eikonal, eq. eik_r.", low=0.0, high=LARGEST)
    weight_eik_phi: float = option(
        0.007, "Topological Eikonal, eq. eik_phi.", low=0.0, high=LARGEST
    )
    weight_lap: float = option(0.0004, "Laplacian, eq. lap.", low=0.0, high=LARGEST)
    weight_phase: float = option(
        0.1,
        "Phase saturation, eq. phase_sat. The paper's 0.002 lets the second wall of a shell drift "
        "away within the iterations that a CPU affords; 0.3 keeps sheets from being completed.",
        low=0.0,
        high=LARGEST,
    )
    weight_far: float = option(0.1, "Far-field repulsion, eq. far_field.", low=0.0, high=LARGEST)
    weight_normal: float = option(
        1.0,
        "Normal alignment, eq. normal_align. The paper's 0.15 leaves pinholes in sheets.",
        low=0.0,
        high=LARGEST,
    )
    rim_normals: float = option(
        0.15,
        "Share of λ normal at the rims of thin walls (0.15 of the default is the paper's): in "
        "full, the normals of both faces bend the narrow one between them outwards.",
        low=0.0,
        high=1.0,
    )
    rim_draws: float = option(
        4.0,
        "How many times as often points of the band, of free space and of the regression are taken "
        "near the rims of thin walls, which turn within a spacing.",
        low=1.0,
        high=100.0,
    )
