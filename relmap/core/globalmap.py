"""The global map: where the relative maps of the groups come together (section III)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from relmap.core.alignment import fit_rigid, fixes_rotation
from relmap.core.growing import GrowingArray

UNMAPPED = -1
"""Piece of a landmark that is not mapped."""


class GlobalMap:
    """Positions of landmarks, each that of the best group of every interval, averaged.

    Where a group shares too little with what is mapped, it founds a new piece of the map, with a
    frame of its own.  Two pieces become one when a group ties them.
    """

    def __init__(self) -> None:
        self._positions: GrowingArray[np.float64] = GrowingArray(np.float64, (0,))
        self._weights: GrowingArray[np.float64] = GrowingArray(np.float64)
        self._settled: GrowingArray[np.float64] = GrowingArray(np.float64, (0,))
        self._settled_weights: GrowingArray[np.float64] = GrowingArray(np.float64)
        self._pieces: GrowingArray[np.int64] = GrowingArray(np.int64)
        self._n_pieces = 0

    @property
    def positions(self) -> NDArray[np.float64]:
        """Position of each landmark (n, d), frame of its piece, metres; NaN if not mapped."""
        return self._positions.values

    @property
    def weights(self) -> NDArray[np.float64]:
        """Number of iterations averaged into each landmark (n,); 0 where it is not mapped."""
        return self._weights.values

    @property
    def pieces(self) -> NDArray[np.int64]:
        """Piece that each landmark belongs to (n,), or `UNMAPPED`."""
        return self._pieces.values

    def resize(self, n: int, dimension: int) -> None:
        """Make room for landmarks 0 to n - 1 of that many coordinates, the new ones not mapped."""
        if not len(self._positions):
            self._positions = GrowingArray(np.float64, (dimension,))
            self._settled = GrowingArray(np.float64, (dimension,))
        self._positions.resize(n, np.nan)
        self._weights.resize(n, 0.0)
        self._settled.resize(n, 0.0)
        self._settled_weights.resize(n, 0.0)
        self._pieces.resize(n, UNMAPPED)

    def pieces_of(self, landmarks: NDArray[np.int64], at_least: int = 1) -> NDArray[np.int64]:
        """Return the pieces that so many of the landmarks belong to, the oldest first."""
        pieces, counts = np.unique(self.pieces[landmarks], return_counts=True)
        return np.asarray(pieces[(pieces != UNMAPPED) & (counts >= at_least)])

    def weights_in(self, piece: int, landmarks: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return the weights (g,) of landmarks, 0 for those outside the piece."""
        return np.where(self.pieces[landmarks] == piece, self.weights[landmarks], 0.0)

    def align(
        self,
        piece: int,
        landmarks: NDArray[np.int64],
        relative_map: NDArray[np.float64],
        n_iterations: NDArray[np.int64],
    ) -> NDArray[np.float64] | None:
        """Fit a group's relative map to those of its members that are mapped in a piece.

        Each counts with the number of iterations behind its two positions, the one in the map and
        the one in the group: variances add, so the weights add in parallel.

        Parameters
        ----------
        piece : int
        landmarks : (g,) int64
        relative_map : (g, d) float64, group frame, metres
        n_iterations : (g,) int64
            Iterations averaged into each position of the relative map.

        Returns
        -------
        (g, d) float64, frame of the piece, metres, or None where the members fix no rotation
        """
        in_map = self.weights_in(piece, landmarks)
        shared = in_map > 0
        there = self.positions[landmarks[shared]]
        if not fixes_rotation(there):
            return None
        weights = 1 / (1 / in_map[shared] + 1 / n_iterations[shared])
        R, t = fit_rigid(relative_map[shared], there, weights)
        return relative_map @ R.T + t

    def new_piece(self) -> int:
        """Return the number of a piece that nothing belongs to yet."""
        self._n_pieces += 1
        return self._n_pieces - 1

    def remove(self, landmarks: NDArray[np.int64]) -> None:
        """Take landmarks (k,) off the map."""
        self.positions[landmarks] = np.nan
        self.weights[landmarks] = 0.0
        self._settled_weights.values[landmarks] = 0.0
        self.pieces[landmarks] = UNMAPPED

    def merge(self, new: int, old: int) -> None:
        """Average a landmark's position into another's, and take it off the map.

        What the new one has in its present interval goes on to be replaced by better groups.
        """
        self.settle(np.array([old]))
        weights = self.weights[[new, old]]
        self.positions[old] = weights @ self.positions[[new, old]] / weights.sum()
        self.weights[old] = weights.sum()
        settled = self._settled_weights.values
        if settled[new] > 0:
            both = settled[[new, old]]
            self._settled.values[old] = both @ self._settled.values[[new, old]] / both.sum()
            settled[old] = both.sum()
        self.remove(np.array([new]))

    def place(
        self,
        piece: int,
        landmarks: NDArray[np.int64],
        positions: NDArray[np.float64],
        weights: NDArray[np.float64],
    ) -> None:
        """Put landmarks (g,) at positions (g, d) of a piece, averaged with what is settled of them.

        Parameters
        ----------
        piece : int
        landmarks : (g,) int64
        positions : (g, d) float64, frame of the piece, metres
        weights : (g,) float64
            In iterations averaged.
        """
        settled = self._settled_weights.values
        settled[landmarks[self.pieces[landmarks] != piece]] = 0.0
        total = settled[landmarks] + weights
        share = (weights / total)[:, None]
        before = self._settled.values[landmarks]
        self.positions[landmarks] = before + share * (positions - before)
        self.weights[landmarks] = total
        self.pieces[landmarks] = piece

    def settle(self, landmarks: NDArray[np.int64]) -> None:
        """Keep what was averaged of landmarks (k,): what is placed later is averaged with it."""
        mapped = landmarks[self.weights[landmarks] > 0]
        self._settled.values[mapped] = self.positions[mapped]
        self._settled_weights.values[mapped] = self.weights[mapped]

    def move(self, landmarks: NDArray[np.int64], positions: NDArray[np.float64]) -> None:
        """Move mapped landmarks (k,), and what is settled of them, to positions (k, d)."""
        self._settled.values[landmarks] += positions - self.positions[landmarks]
        self.positions[landmarks] = positions

    def join(
        self, piece: int, landmarks: NDArray[np.int64], positions: NDArray[np.float64]
    ) -> None:
        """Let other pieces join one where landmarks (g,), placed in it, fix how they lie."""
        for other in self.pieces_of(landmarks):
            if other != piece:
                self._join(int(other), piece, landmarks, positions)

    def _join(
        self,
        other: int,
        piece: int,
        landmarks: NDArray[np.int64],
        positions: NDArray[np.float64],
    ) -> None:
        shared = self.pieces[landmarks] == other
        there = self.positions[landmarks[shared]]
        if fixes_rotation(there):
            self.tie(other, piece, *fit_rigid(there, positions[shared]))

    def tie(self, other: int, piece: int, R: NDArray[np.float64], t: NDArray[np.float64]) -> None:
        """Let a piece join another, in whose frame its own lies at rotation R (d, d) and t (d,)."""
        moved = self.pieces == other
        for places in (self.positions, self._settled.values):
            places[moved] = places[moved] @ R.T + t
        self.pieces[moved] = piece
