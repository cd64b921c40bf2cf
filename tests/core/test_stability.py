"""The stable time step: its closed forms, and that a run is bounded just below it and not just above."""

import math
from dataclasses import replace

import numpy as np
import pytest
from apparatus import chain, do_steps, plain_fabric, sheet
from hypothesis import given, settings
from hypothesis import strategies as st

from cloth_core.fabric import Fabric
from cloth_core.model import Model
from cloth_core.scene import Scene
from cloth_core.stability import largest_eigenpair, stable_time_step


def chain_stiffness(count: int, k: float) -> np.ndarray:
    """Stiffness matrix of `count` masses below a held particle (row and column 0)."""
    matrix = np.zeros((count + 1, count + 1))
    for i in range(count):
        matrix[i : i + 2, i : i + 2] += k * np.array([[1, -1], [-1, 1]])
    return matrix


def chain_limit(count: int, m: float, k: float, damping_time: float = 0.0, air_drag: float = 0.0):
    matrix = chain_stiffness(count, k)
    inverse = np.r_[0.0, np.full(count, 1 / m)]
    return stable_time_step(
        lambda u, a, b: (a + b * damping_time) * (matrix @ u) + b * air_drag * m * u, inverse, tolerance=1e-6
    )


def largest_growth(count: int, m: float, k: float, dt: float, steps: int, **damping: float) -> float:
    """How far any elongation of the chain grows, relative to random elongations of a millionth of its links."""
    x, terms = chain(count, m, k, 0.1, **damping)
    rest = x.copy()
    x[1:, 2] += 1e-7 * np.random.default_rng(count).uniform(-1, 1, count)
    v = np.zeros_like(x)
    largest = 0.0
    for _ in range(steps // 10):
        do_steps(x, v, terms, dt, 10)
        largest = max(largest, float(np.abs(x - rest).max()))
        if largest > 1e-3:
            break
    return largest / 1e-7


@pytest.mark.parametrize("count", [1, 2, 7, 40])
def test_largest_frequency_of_the_hanging_chain(count):
    m, k = 0.02, 300.0
    limit = chain_limit(count, m, k)
    exact = 2 * math.sqrt(k / m) * math.cos(math.pi / (2 * count + 1))
    assert limit.largest_frequency == pytest.approx(exact, rel=1e-5)
    assert limit.time_step == pytest.approx(2 / exact, rel=1e-5)
    assert limit.damping_ratio == 0.0


@pytest.mark.parametrize(("ratio", "w_dt"), [(0.0, 2.0), (0.5, 1.236), (1.0, 0.828), (3.0, 0.3246)])
@pytest.mark.parametrize("kind", ["damping_time", "air_drag"])
def test_limit_with_damping(ratio, w_dt, kind):
    # w dt < 2 (sqrt(1 + z^2) - z) for one mass; z = w tau / 2 of the spring's own damping, k_a / 2w of air.
    m, k = 0.5, 200.0
    w = math.sqrt(k / m)
    amount = {"damping_time": 2 * ratio / w, "air_drag": 2 * ratio * w}[kind]
    limit = chain_limit(1, m, k, **{kind: amount})
    assert limit.damping_ratio == pytest.approx(ratio, rel=1e-6)
    assert limit.time_step * w == pytest.approx(2 * (math.sqrt(1 + ratio**2) - ratio), rel=1e-6)
    assert limit.time_step * w == pytest.approx(w_dt, abs=5e-4)


@pytest.mark.parametrize("count", [1, 6, 25])
def test_undamped_chain_is_bounded_below_the_limit_and_not_above(count):
    m, k = 0.02, 300.0
    dt = chain_limit(count, m, k).time_step
    assert largest_growth(count, m, k, 0.98 * dt, 20_000) < 50.0
    assert largest_growth(count, m, k, 1.02 * dt, 2_000) > 1e4


@pytest.mark.parametrize("ratio", [0.2, 0.5, 1.0, 3.0])
@pytest.mark.parametrize("kind", ["damping_time", "air_drag"])
def test_damped_chain_is_bounded_below_the_limit_and_not_above(ratio, kind):
    count, m, k = 6, 0.02, 300.0
    w = 2 * math.sqrt(k / m) * math.cos(math.pi / (2 * count + 1))
    amount = {"damping_time": 2 * ratio / w, "air_drag": 2 * ratio * w}[kind]
    dt = chain_limit(count, m, k, **{kind: amount}).time_step
    given_to_kernel = {"damping_time": "spring_damping_time", "air_drag": "air_drag"}[kind]
    assert largest_growth(count, m, k, 0.98 * dt, 20_000, **{given_to_kernel: amount}) < 50.0
    assert largest_growth(count, m, k, 1.02 * dt, 20_000, **{given_to_kernel: amount}) > 1e4


# ---- the limit of a whole model


def noise_growth(scene: Scene, stretch: tuple[float, float], share: float, steps: int) -> float:
    """Growth of noise on a stretched sheet whose outline is held, with a share of the stable time step."""
    model = Model(scene)
    x = scene.garment.start * np.array([1 + stretch[0], 1 + stretch[1], 1.0])
    v = np.zeros_like(x)
    calm = 500.0
    do_steps(x, v, model.force_terms(calm), 0.5 * model.stable_step(x, calm).time_step, 5_000)
    v[:] = 0.0  # it is in balance now: the bending springs of the outermost rows had pulled it a little inwards
    dt = share * model.stable_step(x, scene.air_drag).time_step
    terms = model.force_terms(scene.air_drag)
    balanced = x.copy()
    free = model.inverse_mass > 0
    amplitude = 1e-9
    x[free] += amplitude * np.random.default_rng(3).uniform(-1, 1, (int(free.sum()), 3))
    largest = 0.0
    for _ in range(steps // 10):
        do_steps(x, v, terms, dt, 10)
        largest = max(largest, float(np.abs(x - balanced).max()) / amplitude)
        if not largest < 1e5:
            break
    return largest


def held_sheet(fabric: Fabric) -> Scene:
    garment = sheet(0.3, 0.2, 0.02)
    return Scene(garment=garment, fabric=fabric, pins=garment.outline[0], gravity=(0.0, 0.0, 0.0), air_drag=0.5)


LIMITED_BY = {
    "springs": plain_fabric(),
    "springs and their damping": plain_fabric(damping_time=2e-3),
    "bending": plain_fabric(structural_warp=1.0, structural_weft=1.0, shear=1.0, bending=1e-2),
    "bending damping": plain_fabric(bending=1e-4, bending_damping_time=0.5),
    "cotton poplin": Fabric.preset("cotton_poplin", strain_limit=1.0),
}


@pytest.mark.parametrize("stretch", [(0.0, 0.0), (0.05, 0.05)], ids=["flat", "stretched by 5 %"])
@pytest.mark.parametrize("what", LIMITED_BY)
def test_sheet_is_bounded_below_its_stable_time_step_and_not_above(what, stretch):
    scene = held_sheet(LIMITED_BY[what])
    assert noise_growth(scene, stretch, 0.95, 4000) < 100.0
    assert not noise_growth(scene, stretch, 1.05, 4000) < 1e5  # or no longer a number at all


def test_stable_step_of_a_model_is_that_of_its_assembled_matrices():
    # The same matrices column by column, from central differences of the compiled forces, and NumPy's eigenvalues.
    garment = sheet(0.09, 0.06, 0.03)
    scene = Scene(
        garment=garment, fabric=plain_fabric(damping_time=1e-3, bending_damping_time=3e-3), air_drag=2.0,
        pins=np.array([0], dtype=np.int32),
    )  # fmt: skip
    model = Model(scene)
    # Stretched everywhere, so that no spring is softened by compression.
    x = garment.start * 1.03
    n = x.size
    from cloth_core.step import Workspace, total_force

    terms = model.force_terms(2.0)

    def force(at: np.ndarray, speed: np.ndarray) -> np.ndarray:
        work = Workspace.of(len(at))
        total_force(at, speed, terms, 0.0, work)
        return work.force[:, : len(at)].T.ravel()

    k_matrix, c_matrix = np.zeros((n, n)), np.zeros((n, n))
    still = np.zeros_like(x)
    for column in range(n):
        nudge = np.zeros(n)
        nudge[column] = 1e-6
        nudge = nudge.reshape(x.shape)
        k_matrix[:, column] = -(force(x + nudge, still) - force(x - nudge, still)) / 2e-6
        c_matrix[:, column] = -(force(x, nudge) - force(x, -nudge)) / 2e-6
    scale = np.repeat(np.sqrt(model.inverse_mass), 3)
    k_matrix, c_matrix = (scale[:, None] * (a + a.T) / 2 * scale for a in (k_matrix, c_matrix))

    def unstable(dt: float) -> bool:
        return float(np.linalg.eigvalsh(dt * dt * k_matrix + 2 * dt * c_matrix)[-1]) > 4.0

    low, high = 1e-6, 1.0
    while high / low > 1 + 1e-6:
        middle = math.sqrt(low * high)
        low, high = (low, middle) if unstable(middle) else (middle, high)
    stated = model.stable_step(x, 2.0, tolerance=1e-5).time_step
    assert stated == pytest.approx(low, rel=1e-4)


@pytest.mark.parametrize("ratio", [1e3, 1e6])
def test_very_different_masses_next_to_each_other(ratio):
    # A light mass m between two much heavier ones swings with sqrt(2 k / m).
    inverse = np.array([1e-2, ratio * 1e-2, 1e-2])
    k = 100.0
    matrix = k * np.array([[1.0, -1, 0], [-1, 2, -1], [0, -1, 1]])
    limit = stable_time_step(lambda u, a, b: a * (matrix @ u), inverse)
    exact = math.sqrt(np.linalg.eigvals(inverse[:, None] * matrix).real.max())
    assert limit.largest_frequency == pytest.approx(exact, rel=2e-3)
    assert exact == pytest.approx(math.sqrt(2 * k * ratio * 1e-2), rel=2 / ratio)


def test_finer_sheet_has_a_shorter_stable_step_by_itself():
    # Mass falls with h^2 while the stiffness stays: the limit is proportional to the spacing.
    steps = []
    for spacing in (0.04, 0.02, 0.01):
        model = Model(Scene(garment=sheet(0.2, 0.2, spacing), fabric=plain_fabric(bending=0.0), air_drag=0.0))
        steps.append(model.stable_step(model.scene.garment.start, 0.0).time_step)
    assert steps[0] / steps[1] == pytest.approx(2.0, rel=0.05)
    assert steps[1] / steps[2] == pytest.approx(2.0, rel=0.05)
    # In the plane the limit is about sqrt(m / (k_s + k_d)).
    assert steps[2] == pytest.approx(math.sqrt(0.2 * 0.01**2 / 500.0), rel=0.25)


@pytest.mark.parametrize("stiffness", [1e-3, 1e8])
def test_extreme_stiffness_has_a_finite_stable_step(stiffness):
    fabric = replace(plain_fabric(bending=0.0), structural_warp=stiffness, structural_weft=stiffness, shear=stiffness)
    model = Model(Scene(garment=sheet(0.1, 0.1, 0.02), fabric=fabric, air_drag=0.0))
    step = model.stable_step(model.scene.garment.start, 0.0).time_step
    assert step == pytest.approx(math.sqrt(0.2 * 0.02**2 / (2 * stiffness)), rel=0.3)


@settings(max_examples=40, deadline=None)
@given(st.integers(1, 25), st.integers(0, 10**6))
def test_largest_eigenvalue_is_never_underestimated(size, seed):
    rng = np.random.default_rng(seed)
    a = rng.standard_normal((size, size))
    a = a @ a.T
    value, vector = largest_eigenpair(lambda u: a @ u, rng.standard_normal(size), tolerance=1e-4)
    exact = float(np.linalg.eigvalsh(a)[-1])
    assert exact * (1 - 1e-3) <= value <= exact * (1 + 2e-3)
    assert np.linalg.norm(a @ vector - exact * vector) <= 0.05 * exact * np.linalg.norm(vector)


def test_nothing_stiff_means_no_limit():
    limit = stable_time_step(lambda u, a, b: 0 * u, np.ones(3))
    assert limit.time_step == math.inf


def test_limiting_mode_is_found_from_a_start_that_has_no_share_in_it():
    # In the flat state the modes across the plane are apart from those in it: here damping of bending limits, and the
    # search starts from the stiffest mode, which lies in the plane.
    inverse = np.ones(2)
    stiffness = np.array([100.0, 1.0, 1.0])
    damping = np.array([0.0, 0.0, 80.0])
    along_x = np.array([[1.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    for start in (None, along_x):
        limit = stable_time_step(lambda u, a, b: a * stiffness * u + b * damping * u, inverse, start)
        # dt^2 + 160 dt = 4, far below the 0.2 of the stiffest one.
        assert limit.time_step == pytest.approx(math.sqrt(80.0**2 + 4.0) - 80.0, rel=3e-3)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(st.integers(1, 8), st.integers(0, 10**6), st.floats(-3.0, 1.0))
def test_stable_step_is_never_longer_than_that_of_the_matrices(count, seed, log_damping):
    rng = np.random.default_rng(seed)
    n = 3 * count
    k_matrix, c_matrix = (a @ a.T for a in rng.standard_normal((2, n, n)))
    c_matrix = c_matrix * 10.0**log_damping
    limit = stable_time_step(lambda u, a, b: ((a * k_matrix + b * c_matrix) @ u.ravel()).reshape(-1, 3), np.ones(count))
    dt = limit.time_step
    assert 0.99 * 4.0 < np.linalg.eigvalsh(dt * dt * k_matrix + 2 * dt * c_matrix)[-1] <= 4.0 * (1 + 1e-9)


def test_drag_alone_limits_to_two_over_k_a_whatever_little_else_there_is():
    # All modes within a ten thousandth of each other: the Lanczos vectors must stay at right angles all the same.
    k_a, stiffness = 1e3, np.linspace(0.0, 50.0, 300).reshape(-1, 3)
    limit = stable_time_step(lambda u, a, b: a * stiffness * u + b * k_a * u, np.ones(100))
    assert limit.time_step == pytest.approx((math.sqrt(k_a**2 + 4 * 50.0) - k_a) / 50.0, rel=3e-3)


@pytest.mark.parametrize("tolerance", [2e-3, 1e-2])
def test_mode_that_was_the_stiffest_and_is_no_longer_does_not_hide_the_one_that_is(tolerance):
    # A run asks again and again, each time from its last mode. Folding cloth stiffens elsewhere meanwhile.
    stiffness = np.linspace(1.0, 70.0, 1200).reshape(-1, 3)
    stiffness[17, 1] = 100.0
    last = np.zeros_like(stiffness)
    last[-1, -1] = 1.0
    limit = stable_time_step(lambda u, a, b: (a + 0.01 * b) * stiffness * u, np.ones(400), last, tolerance)
    w = 10.0
    exact = 2.0 * (math.sqrt(1.0 + (0.05 * w / w) ** 2) - 0.05) / w  # z = c / 2w = 0.05
    assert exact * 0.97 <= limit.time_step <= exact
