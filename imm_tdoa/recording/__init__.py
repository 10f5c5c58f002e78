"""Recordings and tracks on disk.

>>> recording = read("folder")
>>> measurement, times, values, pairs = recording.scans()
"""

from imm_tdoa.recording.files import read, write
from imm_tdoa.recording.recording import Recording
from imm_tdoa.recording.sections import Noise, TruthScoring
from imm_tdoa.recording.table import Table
from imm_tdoa.recording.tracks import write_geojson, write_kml, write_track

__all__ = [
    "Noise",
    "Recording",
    "Table",
    "TruthScoring",
    "read",
    "write",
    "write_geojson",
    "write_kml",
    "write_track",
]
