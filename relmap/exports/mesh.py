"""Walls as faces and edges, or landmarks as vertices, in a PLY file."""

from __future__ import annotations

import numpy as np

from relmap.core.arrays import Floats, Ints
from relmap.exports.content import MapContent


def ply_text(content: MapContent) -> str:
    """Return a map as ASCII PLY in full precision.

    A wall has an edge along its foot and, if its height is known, a face with the same front.
    Landmarks are vertices only.
    """
    vertices, edges, faces = (
        content.landmarks.position,
        np.empty((0, 2), int),
        np.empty((0, 4), int),
    )
    if content.walls is not None:
        ends, z = content.walls.ends, content.walls.z_extent
        foot, head = (np.dstack([ends, np.repeat(z[:, [k]], 2, axis=1)]) for k in (0, 1))
        n = len(ends)
        edges = np.arange(2 * n).reshape(n, 2)
        high = np.flatnonzero(z[:, 1] > z[:, 0])
        tops = 2 * n + np.arange(2 * len(high)).reshape(-1, 2)
        vertices = np.concatenate([foot.reshape(-1, 3), head[high].reshape(-1, 3)])
        # Seen from the front the right end comes first: left, right, and back along the top is
        # counter-clockwise.
        faces = np.column_stack([edges[high][:, ::-1], tops])
    header = ["ply", "format ascii 1.0", "comment relmap: map frame, metres"]
    header += [f"element vertex {len(vertices)}", *(f"property double {axis}" for axis in "xyz")]
    if len(edges):
        header += [f"element edge {len(edges)}", "property int vertex1", "property int vertex2"]
    if len(faces):
        header += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
    counted = np.column_stack([np.full(len(faces), 4), faces])
    return (
        "\n".join([*header, "end_header"]) + "\n" + "".join(map(_lines, (vertices, edges, counted)))
    )


def _lines(rows: Floats | Ints) -> str:
    return "".join(" ".join(map(repr, row)) + "\n" for row in rows.tolist())
