"""How good an estimate is, where the truth is known.

Of one emitter: `rmse`, `nees`, `nis`, `error_radius`. Of several: distances between the set of
targets and the set of tracks (`ospa`, `gospa`, and over time `ospa_curve`, `gospa_curve`), and
whether each track stays with its target (`follow`, `purity`, `id_switches`, `latency`,
`false_tracks`).
"""

from imm_tdoa.metrics.errors import error_radius, nees, nis, rmse
from imm_tdoa.metrics.sets import Gospa, gospa, gospa_curve, ospa, ospa_curve
from imm_tdoa.metrics.tracks import false_tracks, follow, id_switches, latency, purity

__all__ = [
    "Gospa",
    "error_radius",
    "false_tracks",
    "follow",
    "gospa",
    "gospa_curve",
    "id_switches",
    "latency",
    "nees",
    "nis",
    "ospa",
    "ospa_curve",
    "purity",
    "rmse",
]
