"""Random numbers by name: what is drawn for one thing does not depend on what else there is."""

from __future__ import annotations

import hashlib

import attrs
import numpy as np

Seed = int | np.random.SeedSequence | np.random.Generator


@attrs.frozen
class Streams:
    """Independent random streams of one seed, told apart by names.

    Parameters
    ----------
    root : numpy.random.SeedSequence
        Where all streams come from.
    """

    root: np.random.SeedSequence

    @classmethod
    def from_seed(cls, seed: Seed) -> Streams:
        """Return the streams of a seed; a Generator is drawn from once.

        Raises
        ------
        ValueError
            A seed that is negative or no whole number.
        """
        if isinstance(seed, np.random.SeedSequence):
            return cls(seed)
        if isinstance(seed, np.random.Generator):
            entropy = [int(word) for word in seed.integers(0, 2**32, size=4)]
            return cls(np.random.SeedSequence(entropy))
        if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
            raise ValueError(f"seed: expected a whole number of at least 0, got {seed!r}")
        return cls(np.random.SeedSequence(int(seed)))

    def of(self, *names: str) -> np.random.Generator:
        """Return the stream of these names, from its beginning."""
        digest = hashlib.sha256("\x1f".join(names).encode()).digest()
        words = [int.from_bytes(digest[i : i + 4], "little") for i in range(0, 16, 4)]
        sequence = np.random.SeedSequence(
            self.root.entropy, spawn_key=(*self.root.spawn_key, *words)
        )
        return np.random.Generator(np.random.PCG64(sequence))

    def columns(self, names: tuple[str, ...], columns: tuple[str, ...], rows: int) -> np.ndarray:
        """Return standard normal numbers (rows, columns), each column from its own stream."""
        drawn = [self.of(*names, column).standard_normal(rows) for column in columns]
        return np.stack(drawn, axis=-1)
