"""Recordings and tracks on disk.

>>> recording = read("folder")
>>> measurement, times, values, pairs = recording.scans()
"""

from imm_tdoa.recording.files import read, write
from imm_tdoa.recording.recording import Recording
from imm_tdoa.recording.sections import Noise, TruthScoring
from imm_tdoa.recording.table import Table
from imm_tdoa.recording.tracks import write_geojson, write_kml, write_track
from imm_tdoa.recording.unlabelled import Scan, UnlabelledScans, unlabelled, without_labels

__all__ = [
    "Noise",
    "Recording",
    "Scan",
    "Table",
    "TruthScoring",
    "UnlabelledScans",
    "read",
    "unlabelled",
    "without_labels",
    "write",
    "write_geojson",
    "write_kml",
    "write_track",
]
