"""Several emitters: which rows belong to whom, and how tracks begin, live and end.

`Tracker` does it all: a recording becomes a mapping of names to tracks.

>>> from imm_tdoa import Tracker, bankfile, recording
>>> tracks = Tracker(bankfile.load("aircraft")).run(recording.read("folder"))
>>> for name, life in tracks.lives.items():
...     print(name, life.confirmed, life.heard, life.gaps, life.reason)
>>> tracks.rows, tracks.ignored, tracks.rejected  # what became of the rows; what was not used
>>> recording.write_track("tracks.csv", tracks)
>>> plot.track(tracks, recording)

Its parts are exchangeable, each a small protocol: `Associator` (`Nearest`, `GlobalNearest`,
`Jpda`), `Initiation` (`PairedFixes`), `Confirmation` (`SequentialRatio`, `Hits`), `Deletion`
(`Silence`), `Merging` (`Duplicates`). Its whole state is one frozen `Scene`; `advance` is the
pure function from one scene to the next.

Association alone:

>>> from imm_tdoa.tracking import GlobalNearest, Prediction, Unlabelled
>>> prediction = Prediction([[100.0, 250.0]], [25.0 * np.eye(2)])  # one target, two rows
>>> scan = Unlabelled([104.0, 180.0, 243.0], row=[0, 0, 1])
>>> GlobalNearest()(prediction, scan).values
array([[104., 243.]])
"""

from imm_tdoa.recording.unlabelled import Scan
from imm_tdoa.tracking.advance import advance
from imm_tdoa.tracking.assignment import GlobalNearest, assign
from imm_tdoa.tracking.births import Births, Initiation
from imm_tdoa.tracking.confirmation import Confirmation, Hits, SequentialRatio
from imm_tdoa.tracking.deletion import Deletion, Silence
from imm_tdoa.tracking.duplicates import Duplicates, Merging
from imm_tdoa.tracking.joint import Marginals, marginals
from imm_tdoa.tracking.jpda import Jpda, soft_update
from imm_tdoa.tracking.memory import Heard, Memory
from imm_tdoa.tracking.nearest import Nearest
from imm_tdoa.tracking.pairing import PairedFixes
from imm_tdoa.tracking.rows import Association, Associator, Prediction, Unlabelled
from imm_tdoa.tracking.scene import Scene
from imm_tdoa.tracking.settings import Settings
from imm_tdoa.tracking.standing import Standing, Verdict
from imm_tdoa.tracking.targets import predict_rows, take_in
from imm_tdoa.tracking.tracker import Tracker
from imm_tdoa.tracking.tracks import Life, Tracks

__all__ = [
    "Association",
    "Associator",
    "Births",
    "Confirmation",
    "Deletion",
    "Duplicates",
    "GlobalNearest",
    "Heard",
    "Hits",
    "Initiation",
    "Jpda",
    "Life",
    "Marginals",
    "Memory",
    "Merging",
    "Nearest",
    "PairedFixes",
    "Prediction",
    "Scan",
    "Scene",
    "SequentialRatio",
    "Settings",
    "Silence",
    "Standing",
    "Tracker",
    "Tracks",
    "Unlabelled",
    "Verdict",
    "advance",
    "assign",
    "marginals",
    "predict_rows",
    "soft_update",
    "take_in",
]
