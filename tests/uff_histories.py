"""Time histories as pyuff writes them to UFF files (data set 58)."""

from typing import Any

import numpy as np


def time_history(name: str, time_s: np.ndarray, values: np.ndarray, **fields: Any) -> dict[str, Any]:
    """Data set of evenly spaced values at node 1, direction z, as text and without a unit unless `fields` say so."""
    return {
        "type": 58,
        "binary": 0,
        "id1": name,
        "func_type": 1,
        "rsp_node": 1,
        "rsp_dir": 3,
        "ref_node": 0,
        "ref_dir": 0,
        "abscissa_spacing": 1,
        "ordinate_axis_units_lab": "NONE",
        "orddenom_spec_data_type": 0,
        "x": time_s,
        "data": values,
        **fields,
    }
