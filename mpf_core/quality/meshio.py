"""Reading a mesh that is to be measured: PLY, OBJ, STL or GLB, chosen by the file's extension."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh

from mpf_core.errors import FormatError
from mpf_core.surface.mesh import Mesh

EXTENSIONS = ("ply", "obj", "stl", "glb")


def read_mesh(path: str | Path) -> Mesh:
    """The triangles of a mesh file; vertices at exactly equal positions become one.

    Joining undoes what formats force apart (STL has no shared vertices, OBJ and GLB split them at
    texture seams) and nothing more. Raises FormatError when the file is not a mesh of its format.
    """
    path = Path(path)
    kind = path.suffix.lower().lstrip(".")
    if kind not in EXTENSIONS:
        raise FormatError(
            f"{path.name} has no extension of a mesh that is read",
            advice=f"Use one of .{', .'.join(EXTENSIONS)}.",
        )
    vertices, faces = _loaded(path, kind)
    if len(faces) == 0:
        raise FormatError(f"{path.name} holds no triangles", advice="Give a mesh, not a cloud.")
    if not np.isfinite(vertices).all():
        raise FormatError(f"{path.name} has vertices that are not finite numbers")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise FormatError(f"{path.name} has faces that name vertices it does not have")
    return welded(Mesh(vertices, faces))


def welded(mesh: Mesh) -> Mesh:
    """`mesh` with vertices at exactly equal positions joined; normals and colours are dropped."""
    # Adding 0 makes -0.0 and 0.0 one value.
    unique, inverse = np.unique(mesh.vertices + 0.0, axis=0, return_inverse=True)
    return Mesh(unique, inverse.reshape(-1)[mesh.faces].astype(np.int64))


def _loaded(path: Path, kind: str) -> tuple[np.ndarray, np.ndarray]:
    if not path.is_file():
        raise FormatError(f"there is no file {path}")
    try:
        with path.open("rb") as file:
            mesh = trimesh.load_mesh(file, file_type=kind, process=False)
        vertices = np.asarray(mesh.vertices, dtype=np.float64).reshape(-1, 3)
        faces = np.asarray(getattr(mesh, "faces", ()), dtype=np.int64).reshape(-1, 3)
    except Exception as error:
        # The loaders raise whatever a malformed byte led them to.
        raise FormatError(
            f"{path.name} cannot be read as {kind.upper()}",
            where=f"{type(error).__name__}: {error}",
        ) from error
    return vertices, faces
