import math

import pytest

from ssdr.errors import FormatError
from ssdr.io.budget import MOST_BYTES, afford


@pytest.mark.parametrize("size", [MOST_BYTES + 1, 10**400, math.inf, math.nan])
def test_more_than_the_limit_is_refused_with_all_that_a_user_needs(size):
    with pytest.raises(FormatError, match=r"a\.glb: 8 frames needs .* limit of 17179869184 .*max_"):
        afford(size, "8 frames", "a.glb")


def test_the_callers_limit_counts_where_there_is_one():
    afford(MOST_BYTES, "it", "a.glb")
    afford(MOST_BYTES + 1, "it", "a.glb", most=MOST_BYTES + 1)
    with pytest.raises(FormatError, match="limit of 10 "):
        afford(11, "it", "a.glb", most=10)
