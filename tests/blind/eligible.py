"""On which scenes an effect can be told from its rivals in principle, and on which it cannot.

Read from the physics; for biases a test holds that no other bias, fitted freely, leaves less of a faint effect than a
recording can show.
"""

EVERY = ("boards", "slanted_wall", "corridor", "corner", "near_far", "stairs", "room", "open_hall")
CLOSED = ("boards", "slanted_wall", "corner", "near_far", "stairs", "room")  # no open space to speak of

# A constant on every surface, a sine over range or a power of amplitude are told apart by surfaces that span range
# and angle: every family has one slanted panel, and one or more others.
FAMILIES: dict[str, tuple[str, ...]] = {
    "range_offset": ("boards", "slanted_wall", "corner", "near_far", "stairs", "room", "corridor"),
    "surface_pose": ("boards", "near_far", "stairs", "slanted_wall", "corner", "room"),
    "surface_offset": ("boards", "near_far", "stairs", "slanted_wall", "corner", "room"),
    "wiggling": ("slanted_wall", "corridor", "room", "stairs", "corner"),
    "tap_mismatch": ("slanted_wall", "corridor", "room", "stairs"),
    "amplitude_walk": ("near_far", "room", "corridor", "slanted_wall"),
    "temperature_drift": EVERY,
    "smooth_pattern": EVERY,
    "fixed_pattern": EVERY,
    "scattering": ("near_far", "boards", "room"),
    "internal_reflection": ("near_far", "room", "corridor", "slanted_wall"),
    "multipath": ("boards", "near_far", "stairs", "slanted_wall", "corner", "room"),
    "phase_wrapping": ("far_hall", "far_gate"),
    "flying_pixels": ("boards", "near_far", "stairs", "room"),
    "excess_noise": EVERY,
    "vignetting": EVERY,
    "outliers": EVERY,
    "near_return": EVERY,
    "stuck_pixels": EVERY,
    "dropout": CLOSED,
    "temporal_correlation": EVERY,
    "interference": EVERY,
    "saturation": ("near_far", "room", "slanted_wall", "boards"),
    "motion": ("boards", "near_far", "stairs", "slanted_wall", "corner", "room"),
    "quantisation": EVERY,
    "pixel_crosstalk": ("boards", "near_far", "stairs", "room"),
}

# Under room light: no surface so near and bright that its noise is below a millimetre, none so dark and far that its
# phase is lost; and a scene in which dark and bright boards stand side by side.
ROOM_LIGHT: dict[str, tuple[str, ...]] = {
    kind: tuple(
        family if family != "near_far" else "dark_and_bright"
        for family in families
        if family not in ("corridor", "open_hall")
    )
    for kind, families in FAMILIES.items()
    if kind != "phase_wrapping"  # beyond a turn dark surfaces are too noisy
}
MISSING_OBJECT = ("boards", "slanted_wall", "corner", "stairs", "room", "open_hall")

# What no recording of such a scene can tell apart; such cases are not in the bench.
INSEPARABLE: tuple[tuple[str, str, str], ...] = (
    ("range_offset", "surface_pose", "one flat surface that faces the camera: its place and a delay are one number"),
    ("range_offset", "multipath", "a second bounce on every surface alike, if the amplitude's scale is unknown"),
    ("surface_pose", "multipath", "a small board that faces the camera, if its reflectivity is unknown"),
    (
        "surface_offset",
        "surface_pose",
        "a small board that faces the camera: its place and material are one number",
    ),
    ("surface_offset", "multipath", "no amplitudes: a path a quarter turn longer moves ranges and leaves the noise"),
    ("smooth_pattern", "surface_pose", "one flat surface that fills the image: its tilt is a slope over the image"),
    ("wiggling", "surface_pose", "boards that face the camera, each at one range: a sine has any value at each"),
    ("tap_mismatch", "range_offset", "ranges that span a small part of half a turn: a sine is a constant there"),
    ("amplitude_walk", "surface_pose", "boards that face the camera, each of one amplitude"),
    ("temperature_drift", "motion", "one surface: it moves, or all ranges do"),
    ("scattering", "range_offset", "surfaces at one range and of one amplitude: the veil has their own phase"),
    ("internal_reflection", "range_offset", "surfaces at one range and of one amplitude: one phasor turns all alike"),
    ("internal_reflection", "scattering", "one bright surface so near that its light has the phase of the window's"),
    ("flying_pixels", "pixel_crosstalk", "no edges in the image: neither does anything"),
    ("phase_wrapping", "surface_pose", "all of the scene beyond the turn, and its distance unknown"),
    ("dropout", "saturation", "one amplitude in the whole image: lost samples do not tell which side is cut"),
    ("excess_noise", "vignetting", "a narrow field of view: the fall is the same everywhere"),
    ("stuck_pixels", "fixed_pattern", "a surface at the stuck value, quieter than a millimetre"),
)
