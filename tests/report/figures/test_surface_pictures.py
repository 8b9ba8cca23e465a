"""Pictures of surfaces on the report page."""

import numpy as np

from tofmix.report.figures.surface_pictures import edge_parts
from tofmix.surfaces.found import Edges, no_edges


def _line(*places: tuple[float, float]) -> Edges:
    row, col = np.array(places, dtype=np.float32).T
    number = np.zeros(len(places), dtype=np.int32)
    return Edges(row=row, col=col, stderr=np.full(len(places), 0.01, np.float32), near=number, far=number, line=number)


def test_a_level_line_runs_through_the_parts_of_its_row() -> None:
    marked = edge_parts(_line((1.0, 0.0), (1.0, 3.0)), (16, 24), 4)
    assert np.flatnonzero(marked.any(axis=1)).tolist() == [
        6
    ]  # the centre of pixel row 1 is the border of parts 5 and 6
    assert np.flatnonzero(marked.any(axis=0)).tolist() == list(range(2, 15))


def test_a_slanted_line_has_no_gaps() -> None:
    marked = edge_parts(_line((0.0, 0.0), (5.0, 2.0)), (64, 64), 8)
    rows = np.flatnonzero(marked.any(axis=1))
    assert rows.tolist() == list(range(rows[0], rows[-1] + 1))


def test_places_off_the_image_are_drawn_at_its_border() -> None:
    assert edge_parts(_line((-0.7, 0.0)), (16, 16), 4)[0].sum() == 1


def test_no_edges_mark_nothing() -> None:
    assert not edge_parts(no_edges(), (16, 16), 4).any()
