import math

import pytest

from core.compiled import compiled


@compiled
def _finite(value: float) -> bool:
    return math.isfinite(value)


@pytest.mark.parametrize(("value", "finite"), [(1.0, True), (math.nan, False), (math.inf, False), (-math.inf, False)])
def test_compiled_code_still_sees_nan_and_infinity(value, finite):
    assert _finite(value) == finite
