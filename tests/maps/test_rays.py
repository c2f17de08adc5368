"""First losses along rays whose lost intervals are known."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest

from zeno_orbits.maps import Attractor, AttractorClass
from zeno_orbits.maps.rays import Loss, Ray, RayTrial

REST = Attractor(fate=AttractorClass.REST)


def ray(
    *lost: tuple[float, float], tried: list[float] | None = None
) -> Callable[[float], RayTrial]:
    """Return trials of a ray with lost intervals, with late returns next to them."""

    def trial(impulse: float) -> RayTrial:
        if tried is not None:
            tried.append(impulse)
        for low, high in lost:
            if low <= impulse <= high:
                return RayTrial(impulse=impulse, beyond=REST, delay=math.inf)
        away = min((abs(impulse - end) for pair in lost for end in pair), default=1.0)
        return RayTrial(impulse=impulse, beyond=None, delay=5.0 - math.log(away))

    return trial


def first_loss(
    tried: Callable[[float], RayTrial], reach: float, steps: int, error: float
) -> Loss | None:
    return Ray(tried=tried, period=1.0, error=error).first_loss(reach, steps)


@pytest.mark.parametrize("place", [0.137, 0.5, 0.77])
@pytest.mark.parametrize("error", [1e-2, 1e-6])
def test_a_single_loss_is_located_to_its_error(place: float, error: float) -> None:
    found = first_loss(ray((place, 2.0)), 1.0, 10, error)
    assert found is not None
    assert found.kept < place <= found.gone
    assert found.gone - found.kept <= error * found.gone
    assert found.beyond is REST


@pytest.mark.parametrize("middle", [0.233, 0.351, 0.649])
@pytest.mark.parametrize("width", [1e-1, 2e-2, 6e-3])
def test_a_lost_interval_between_two_impulses_of_the_scan_is_found(
    middle: float, width: float
) -> None:
    # The steps are 0.1. Without late returns beside it, no impulse would be tried in the interval.
    low = middle - width / 2
    found = first_loss(ray((low, low + width), (0.95, 2.0)), 1.0, 10, 1e-4)
    assert found is not None
    assert found.kept < low <= found.gone < low + width
    assert found.gone - found.kept <= 1e-4 * found.gone


@pytest.mark.parametrize("width", [2e-2, 1e-3])
def test_the_first_of_several_losses_in_the_last_step_is_found(width: float) -> None:
    # The last step is divided into parts of 0.0125. A narrow loss lies between two of its ends.
    found = first_loss(ray((0.53, 0.53 + width), (0.575, 2.0)), 1.0, 10, 1e-4)
    assert found is not None
    assert found.gone == pytest.approx(0.53, rel=2e-4)


def test_a_return_inside_a_loss_does_not_hide_the_loss() -> None:
    # The scan meets the one return between 0.642 and 2, and it comes late.
    found = first_loss(ray((0.642, 0.699), (0.701, 2.0)), 1.0, 10, 1e-4)
    assert found is not None
    assert found.gone == pytest.approx(0.642, rel=2e-4)


def test_a_ray_without_a_loss_has_none() -> None:
    tried = list[float]()
    assert first_loss(ray(tried=tried), 1.0, 8, 1e-3) is None
    # Between the orbit itself and the first impulse the return gets later by five periods.
    assert tried[:8] == [k / 8 for k in range(1, 9)]
    assert len(tried) == 15
    assert max(tried[8:]) < 1 / 8


def test_a_loss_at_every_impulse_ends_at_the_smallest_double() -> None:
    found = first_loss(ray((0.0, 2.0)), 1.0, 4, 1e-3)
    assert found is not None
    assert 0.0 == found.kept < found.gone < 1e-300
