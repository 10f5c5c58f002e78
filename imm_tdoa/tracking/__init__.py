"""Several emitters: which unlabelled rows belong to which target.

>>> from imm_tdoa.tracking import GlobalNearest, Prediction, Unlabelled
>>> prediction = Prediction([[100.0, 250.0]], [25.0 * np.eye(2)])  # one target, two rows
>>> scan = Unlabelled([104.0, 180.0, 243.0], row=[0, 0, 1])
>>> GlobalNearest()(prediction, scan).values
array([[104., 243.]])

`Nearest`, `GlobalNearest` and `Jpda` are exchangeable: each is an `Associator`.
"""

from imm_tdoa.tracking.assignment import GlobalNearest, assign
from imm_tdoa.tracking.joint import Marginals, marginals
from imm_tdoa.tracking.jpda import Jpda, soft_update
from imm_tdoa.tracking.nearest import Nearest
from imm_tdoa.tracking.rows import Association, Associator, Prediction, Unlabelled
from imm_tdoa.tracking.targets import predict_rows, take_in

__all__ = [
    "Association",
    "Associator",
    "GlobalNearest",
    "Jpda",
    "Marginals",
    "Nearest",
    "Prediction",
    "Unlabelled",
    "assign",
    "marginals",
    "predict_rows",
    "soft_update",
    "take_in",
]
