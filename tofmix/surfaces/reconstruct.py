"""From the layers of one window to its surfaces, their edges, and a finer range image."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import BoolArray, FloatArray
from tofmix.layers import Layers
from tofmix.optics.projection import Projection, beam_directions_of, unit
from tofmix.sensor import Sensor
from tofmix.surfaces.areas import to_areas
from tofmix.surfaces.edge_fit import fit_edges
from tofmix.surfaces.edge_lines import trace, widened
from tofmix.surfaces.edge_shape import FIT_COLUMNS
from tofmix.surfaces.found import NO_SURFACE, Planes, WindowSurfaces
from tofmix.surfaces.linking import Linked, link
from tofmix.surfaces.nodes import Nodes, make_nodes
from tofmix.surfaces.painting import continue_edges, paint_row, share_out
from tofmix.surfaces.regions import choose_regions, ray_lines
from tofmix.surfaces.settings import DEFAULT_SETTINGS, EdgeSettings, SurfaceSettings
from tofmix.surfaces.shares import Cuts, Shares, make_cuts, make_shares
from tofmix.surfaces.smooth_fits import SmoothFits, SurfaceView, fit_smooth
from tofmix.surfaces.smooth_linking import link_smooth

_THREADS, _PARTS = 2, 16
"""Fits do not depend on each other; parts of the work even out."""


def reconstruct(
    layers: Layers, sensor: Sensor, *, factor: int = 8, settings: SurfaceSettings = DEFAULT_SETTINGS
) -> WindowSurfaces:
    """Find the surfaces of one window.

    Parameters
    ----------
    layers : Layers
        Of the leading shape (row, col).
    sensor : Sensor
        The camera; its optics place the pixels.
    factor : int
        Parts of a pixel along each side in the fine range image.

    Raises
    ------
    ValueError
        If it is not known where the pixels look. The message begins with a key.
    """
    optics = _optics_of(sensor)
    rows, cols = layers.shape
    directions = beam_directions_of(optics, (rows, cols))
    nodes = make_nodes(layers, directions, settings.link)
    rays = pixel_rays(optics, (rows, cols))
    linked, smooth = link_smooth(layers, nodes, link(nodes, settings.link), rays, settings)
    shapes, smooth_fits = fit_smooth(nodes, linked, smooth)
    areas = to_areas(
        make_shares(layers, nodes, linked, settings.share), sensor.share_law, layers, nodes, linked, settings.brightness
    )
    shares = areas.shares
    cuts = make_cuts(shares, shapes, directions, settings.share)
    view = SurfaceView(shapes, directions, rays)
    fits = widened(_fit(cuts, shares, view, settings.edge), cuts, shares, settings.edge)
    lines = ray_lines(
        fits, cuts.row, cuts.col, np.asarray(np.linalg.inv(np.moveaxis(rays[..., [1, 2, 0], :], -1, -2)), np.float64)
    )
    regions = choose_regions(fits, lines, cuts, shares, view, settings.edge)
    silent = _silent(layers, shares)
    painted = continue_edges(shares, cuts, fits, lines, regions, view, silent, settings.edge)
    range_fine = np.empty((rows * factor, cols * factor), np.float32)
    surface_fine = np.empty((rows * factor, cols * factor), np.int32)
    for row in range(rows):
        part = slice(row * factor, (row + 1) * factor)
        fine = _part_directions(optics, row, factor, (rows, cols))
        paint_row(
            row,
            factor,
            painted,
            view,
            fine,
            *_smooth_parts(smooth_fits, row, fine),
            range_fine[part],
            surface_fine[part],
            settings.share.most_off,
        )
    share_out(factor, silent & (painted.entries == 0), range_fine, surface_fine)
    kept = int((linked.sizes >= settings.link.least_layers).sum())
    edges = trace(painted.cuts, painted.regions, kept)
    edges = replace(edges, far=np.where(edges.far < kept, edges.far, NO_SURFACE).astype(np.int32))
    surface_fine[surface_fine >= kept] = NO_SURFACE
    return WindowSurfaces(
        surface=_numbers(nodes, linked, kept),
        planes=_planes(nodes, linked, smooth_fits, kept),
        edges=edges,
        range_fine=range_fine,
        surface_fine=surface_fine,
        assumed=areas.assumed,
    )


def link_layers(layers: Layers, sensor: Sensor, *, settings: SurfaceSettings = DEFAULT_SETTINGS) -> NDArray[np.int32]:
    """The surface (row, col, layer) of each layer, numbered as by `reconstruct`, without edges or a fine image.

    Parameters and errors are those of `reconstruct`.
    """
    optics, shape = _optics_of(sensor), (layers.shape[0], layers.shape[1])
    nodes = make_nodes(layers, beam_directions_of(optics, shape), settings.link)
    linked, _ = link_smooth(layers, nodes, link(nodes, settings.link), pixel_rays(optics, shape), settings)
    return _numbers(nodes, linked, int((linked.sizes >= settings.link.least_layers).sum()))


def _optics_of(sensor: Sensor) -> Projection:
    if sensor.optics is None:
        raise ValueError("sensor: no field of view, so surfaces cannot be placed")
    return sensor.optics


def _numbers(nodes: Nodes, linked: Linked, kept: int) -> NDArray[np.int32]:
    """The surface (row, col, layer) of each layer, of the first `kept` surfaces."""
    surface = np.where(nodes.index >= 0, np.append(linked.label, NO_SURFACE)[nodes.index], NO_SURFACE)
    return np.where(surface < kept, surface, NO_SURFACE).astype(np.int32)


def _fit(cuts: Cuts, shares: Shares, view: SurfaceView, settings: EdgeSettings) -> FloatArray:
    """Fit all cuts, those of nearer surfaces first, in two threads."""
    fits = np.zeros((len(cuts.row), FIT_COLUMNS))
    with ThreadPoolExecutor(_THREADS) as pool:
        for entry in range(int(cuts.entry.max(initial=-1)) + 1):
            which, nearer = np.flatnonzero(cuts.entry == entry), fits.copy()
            jobs = [
                pool.submit(fit_edges, part, fits, nearer, cuts, shares, view, settings)
                for part in np.array_split(which, _PARTS)
            ]
            for job in jobs:
                job.result()
    return fits


def _silent(layers: Layers, shares: Shares) -> BoolArray:
    """Pixels (row, col) with layers but without shares, because their mixing is undecided."""
    return np.asarray((shares.entries == 0) & (layers.n_modes > 0))


def pixel_rays(optics: Projection, shape: tuple[int, int]) -> FloatArray:
    """Rays (row, col, 3, 3): through the centre of each pixel, and their change to the next row and column."""
    rows, cols = np.meshgrid(*(np.arange(n, dtype=np.float64) for n in shape), indexing="ij")
    centre = optics.rays(rows, cols, shape=shape)
    down = optics.rays(rows + 0.5, cols, shape=shape) - optics.rays(rows - 0.5, cols, shape=shape)
    across = optics.rays(rows, cols + 0.5, shape=shape) - optics.rays(rows, cols - 0.5, shape=shape)
    return np.ascontiguousarray(np.stack([centre, down, across], axis=-2))


def _part_directions(optics: Projection, row: int, factor: int, shape: tuple[int, int]) -> FloatArray:
    """Unit vectors (factor, cols * factor, 3) through the centres of the parts of a row's pixels."""
    places = (np.arange(factor) + 0.5) / factor - 0.5
    across = (np.arange(shape[1])[:, np.newaxis] + places).ravel()
    return np.ascontiguousarray(unit(optics.rays((row + places)[:, np.newaxis], across, shape=shape)))


def _smooth_parts(fits: SmoothFits | None, row: int, fine: FloatArray) -> tuple[NDArray[np.int32], FloatArray]:
    """Row of the second array of each smooth surface in the pixels of a row, and 1 / r in the parts of the pixels."""
    if fits is None:
        return np.zeros((0, 0), np.int32), np.zeros((0, 0))
    first, inverses = fits.inverses(row, fine)
    items = fits.item[:, row]
    return np.where(items >= 0, items - first, -1).astype(np.int32), inverses


def _planes(nodes: Nodes, linked: Linked, fits: SmoothFits | None, kept: int) -> Planes:
    """Planes of the first `kept` surfaces; m . d = 1/r is (m / |m|) . x = 1 / |m|. NaN for smooth surfaces."""
    length = np.linalg.norm(linked.planes[:kept], axis=1)
    length = np.where(linked.smooth[:kept] >= 0, np.nan, length)
    range_mm = 1.0 / (linked.planes[linked.label] * nodes.direction).sum(axis=1)
    ours = linked.label < kept
    counted = ours
    if fits is not None:
        bent = linked.smooth[linked.label] >= 0
        range_mm = np.where(bent, fits.mean_mm, range_mm)
        counted = ours & ~(bent & np.isnan(range_mm))
    miss, used = np.zeros(kept), np.zeros(kept)
    np.add.at(miss, linked.label[counted], (1.0 / nodes.inverse[counted] - range_mm[counted]) ** 2)
    np.add.at(used, linked.label[counted], 1.0)
    return Planes(
        n_pixels=linked.sizes[:kept].astype(np.uint32),
        normal=(linked.planes[:kept] / length[:, np.newaxis]).astype(np.float32),
        offset_mm=(1.0 / length).astype(np.float32),
        rms_mm=np.sqrt(miss / used).astype(np.float32),
    )
