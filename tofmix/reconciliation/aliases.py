"""What recording would tell two effects apart that the one at hand does not."""

_SEPARATE: tuple[tuple[frozenset[str], str], ...] = (
    (frozenset({"range_offset", "surface_pose"}), "a second surface"),
    (frozenset({"range_offset", "temperature_drift"}), "20 minutes from power-on"),
    (frozenset({"temperature_drift", "motion"}), "20 minutes from power-on, or a second surface that stands still"),
    (frozenset({"range_offset", "amplitude_walk"}), "a dark and a bright board at one distance"),
    (frozenset({"range_offset", "wiggling"}), "more distances, spread over a quarter of the unambiguous range"),
    (frozenset({"range_offset", "fixed_pattern"}), "another scene: the pattern stays with its pixels"),
    (frozenset({"range_offset", "multipath"}), "a scene without a surface beside the one that is too far"),
    (frozenset({"surface_pose", "multipath"}), "the same surface alone, without others around it"),
    (frozenset({"surface_pose", "motion"}), "a longer recording"),
    (frozenset({"surface_pose", "wiggling"}), "the same surface at a second distance"),
    (frozenset({"surface_pose", "amplitude_walk"}), "the same surface with another reflectivity"),
    (frozenset({"wiggling", "amplitude_walk"}), "a dark and a bright board at one distance"),
    (frozenset({"wiggling", "fixed_pattern"}), "the same image at a second distance"),
    (frozenset({"scattering", "multipath"}), "the same scene without its brightest surface"),
    (frozenset({"dropout", "saturation"}), "surfaces of other reflectivities"),
    (frozenset({"excess_noise", "vignetting"}), "a flat wall that fills the image"),
    (frozenset({"flying_pixels", "pixel_crosstalk"}), "edges between surfaces of very different brightness"),
)


def separate_by(kinds: list[str]) -> str:
    """A recording that separates the first of these kinds from the others.

    Parameters
    ----------
    kinds : list of str
        The kind that was chosen, then those that explain as much.
    """
    wanted = [words for pair, words in _SEPARATE if kinds[0] in pair and pair & set(kinds[1:])]
    return "; ".join(dict.fromkeys(wanted)) or "another scene, with other distances and reflectivities"
