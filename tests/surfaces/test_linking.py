"""Linking of layers into surfaces."""

import numpy as np
from numpy.random import default_rng
from support.edges import DEVICE, camera, counted, judge_links
from support.plates import SMALL, Plate, facing, scene, wall

from tofmix.layers import Layers
from tofmix.optics.projection import beam_directions_of
from tofmix.surfaces.linking import link
from tofmix.surfaces.nodes import make_nodes
from tofmix.surfaces.reconstruct import reconstruct


def _surface(plates: list[Plate], seed: int = 1, frames: int = 100) -> tuple[np.ndarray, float, float]:
    """Surface of each layer, purity and completeness."""
    one = scene(plates, SMALL)
    layers = counted(one, frames, seed)
    found = reconstruct(layers, camera(SMALL), factor=2)
    links = judge_links(one, layers, found.surface)
    return found.surface, links.purity, links.completeness


def test_a_slanted_wall_is_one_surface_and_a_board_before_it_another() -> None:
    surface, purity, completeness = _surface([wall(2500.0, yaw_deg=45.0, pitch_deg=10.0)])
    assert purity == 1.0
    assert completeness == 1.0
    assert (surface[..., 0] == 0).all()
    board = facing(SMALL, 20, 30, 1800.0, size_pixels=(25.0, 20.0), tilt_deg=(20.0, 5.0), roll_deg=20.0)
    surface, purity, completeness = _surface([board, wall(3000.0)])
    assert purity > 0.999
    assert completeness > 0.999
    assert (np.bincount(surface[surface >= 0]) > 100).sum() == 2
    assert surface[0, 0, 0] == 0  # the wall has more pixels


def test_walls_part_at_creases_and_not_by_scatter() -> None:
    left = Plate(center_mm=(-1000.0, 0.0, 2000.0), half_mm=(5000.0, 5000.0), yaw_deg=50.0)
    right = Plate(center_mm=(1000.0, 0.0, 2000.0), half_mm=(5000.0, 5000.0), yaw_deg=-50.0)
    _, purity, completeness = _surface([left, right])
    assert purity > 0.98  # at the crease the two are the same within their errors
    assert completeness > 0.95
    slats = [facing(SMALL, 23.5, col, 1500.0, size_pixels=(6.0, 200.0)) for col in (10.0, 25.0, 40.0)]
    surface, purity, completeness = _surface([*slats, wall(2600.0, yaw_deg=10.0)])
    assert purity > 0.999
    assert completeness > 0.999
    assert surface[5, 17, 0] == surface[5, 32, 0] == surface[40, 55, 0]
    layers = counted(scene([wall(2500.0)], SMALL), 100, 4)
    layers.range[..., 0] += default_rng(4).normal(0.0, 8.0 * layers.range_stderr[..., 0]).astype(np.float32)
    found = reconstruct(layers, camera(SMALL), factor=2)
    assert (found.surface[..., 0] == 0).mean() > 0.999
    assert DEVICE.design_sigma(np.array([2500.0]))[0] > 1.0  # the scatter was of some mm
    found = reconstruct(Layers.empty((6, 8), 3), camera(SMALL), factor=4)
    assert (found.surface == -1).all()
    assert len(found.planes) == 0
    assert np.isnan(found.range_fine).all()
    assert found.edges.lines() == []


def test_second_layer_on_the_plane_of_the_first_is_of_the_same_surface() -> None:
    layers = counted(scene([wall(2500.0), wall(4000.0)], SMALL), 100, 1)  # room for two layers
    layers.n_modes[20, 30] = 2
    layers.range[20, 30, 1] = layers.range[20, 30, 0] + layers.range_stderr[20, 30, 0]
    for name in ("range_stderr", "sigma", "probability"):
        getattr(layers, name)[20, 30, 1] = getattr(layers, name)[20, 30, 0]
    layers.weight[20, 30, :2] = 0.5
    found = reconstruct(layers, camera(SMALL), factor=2)
    assert (found.surface[20, 30, :2] == 0).all()
    assert len(found.edges) == 0


def test_planes_are_those_of_the_scene_within_their_errors() -> None:
    one = scene([wall(2500.0, yaw_deg=30.0)], SMALL)
    layers = counted(one, 100, 3)
    nodes = make_nodes(layers, beam_directions_of(camera(SMALL).optics, layers.shape))  # type: ignore[arg-type]
    linked = link(nodes)
    normal = np.array([np.sin(np.deg2rad(30.0)), 0.0, np.cos(np.deg2rad(30.0))])
    true = normal / (normal[2] * 2500.0)
    miss = linked.planes[0] - true
    assert miss @ np.linalg.solve(linked.covariances[0], miss) < 16.3  # chi-square, 3 numbers: one in a thousand
