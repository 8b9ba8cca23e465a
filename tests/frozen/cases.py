"""The commands that each input goes through, and the inputs that they need.

Every file that they write, their standard output and error, and their exit codes are frozen.
"""

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """Commands on some inputs."""

    inputs: str
    """Names in `frozen.inputs.INPUTS`, with spaces between."""
    commands: str
    """Command lines without `tofmix`, one a line, as a shell would split them."""
    is_stored: bool = False
    """Whether the values of the outcome are kept in the repository, for the quick tests."""


_GAP = "--effects wiggling,range_offset,surface_pose,fixed_pattern --json"

CASES: Mapping[str, Case] = {
    "whole": Case(
        inputs="three_boards",
        commands="""
            info three_boards.h5
            verify three_boards.h5 --json
            estimate three_boards.h5 --json
            verify three_boards.layers.h5
            info three_boards.layers.h5 --json
            report three_boards.layers.h5 --recording three_boards.h5 --html page.html
            inspect three_boards.layers.h5 --pixel 12,92 --recording three_boards.h5 --neighbours 1 -o pixel.svg
            surfaces three_boards.layers.h5 --json
            report three_boards.layers.h5 --surfaces three_boards.surfaces.h5 --html surfaces.html --json
            map three_boards.layers.h5 -o map.yaml --voxels map.npz --cell 100
        """,
    ),
    "real": Case(
        inputs="real",
        commands="""
            estimate tmf8829_edge.h5
            report tmf8829_edge.layers.h5 --json
            inspect tmf8829_edge.layers.h5 --pixel 7,8 --recording tmf8829_edge.h5 -o pixel.svg
            info tmf8829_edge.layers.h5
        """,
    ),
    "windows": Case(
        inputs="boards",
        commands="""
            estimate boards.h5 --window 20 --stride 10 --max-layers 3
            report boards.layers.h5 --window 1
            surfaces boards.layers.h5
            verify boards.layers.h5 boards.surfaces.h5
            inspect boards.layers.h5 --pixel 4,7 --window 2 --recording boards.h5 --over-frames -o frames.svg
            export boards.layers.h5 -o second.png --layer 2 --window 1
        """,
    ),
    "shards": Case(
        inputs="boards",
        commands="""
            estimate boards.h5 --window 20 --shard 1/2
            estimate boards.h5 --window 20 --shard 2/2
            merge boards.layers.1-of-2.part boards.layers.2-of-2.part -o boards.layers.h5
            merge boards.layers.1-of-2.part -o half.layers.h5
        """,
    ),
    "choices": Case(
        inputs="small boards",
        commands="""
            estimate small.h5 -o paper.layers.h5 --paper --gamma 0.1
            estimate small.h5 -o cpdf.layers.h5 --counter cpdf --bins 30
            estimate small.h5 -o fourier.layers.h5 --counter fourier --refine none
            estimate small.h5 -o tied.layers.h5 --sigma tied --noise sr3000
            estimate boards.h5 -o free.layers.h5 --sigma free --outliers auto
            estimate boards.h5 -o auto.layers.h5 --sigma tied --noise auto
            estimate small.h5 boards.h5 --output-dir both --false-alarm 0.01 --json
            compare auto.layers.h5 free.layers.h5 --tolerance 0.5 --html page.html
            compare tied.layers.h5 tied.layers.h5 --json
            compare tied.layers.h5 both/boards.layers.h5
        """,
    ),
    "unknown": Case(
        inputs="unknown",
        commands="""
            estimate unknown.h5
            estimate unknown.h5 -o plain.layers.h5 --noise auto --noise-shape gaussian --noise-widths common
            report unknown.layers.h5 --recording unknown.h5 --html page.html
            export unknown.layers.h5 -o points.csv --fov 20x16 --fields all
            surfaces unknown.layers.h5
        """,
    ),
    "folded": Case(inputs="folded", commands="estimate folded.h5 --wrap\nreport folded.layers.h5\ninfo folded.h5"),
    "open": Case(
        inputs="open_space",
        commands="""
            estimate open_space.h5
            surfaces open_space.layers.h5
            map open_space.layers.h5 -o map.yaml --height -600,300 --pitch 7 --pose 1000,-500,30 --voxels map.ply
            map open_space.layers.h5 -o averaged.yaml --from averaged --recording open_space.h5
            map open_space.layers.h5 -o thin.yaml --from thin-beam --recording open_space.h5
        """,
    ),
    "amplitudes": Case(
        inputs="by_amplitude",
        commands="estimate by_amplitude.h5\nreport by_amplitude.layers.h5\ninfo by_amplitude.h5 --json",
    ),
    "shaped": Case(
        inputs="shaped",
        commands="""
            estimate shaped.h5
            report shaped.layers.h5 --recording shaped.h5 --html page.html
            inspect shaped.layers.h5 --pixel 8,8 --recording shaped.h5 -o pixel.svg --json
        """,
    ),
    "targets": Case(
        inputs="targets",
        commands="""
            import targets.npy -o targets.h5 --axes frame,target,row,col --sensor vl53l5cx --frame-rate 15
            import targets.npy -o nearest.h5 --axes frame,target,row,col --target nearest
            estimate targets.h5 --max-layers 4
            report targets.layers.h5 --recording targets.h5
            info targets.h5
        """,
    ),
    "coarse": Case(inputs="coarse", commands="estimate coarse.h5\nreport coarse.layers.h5 --json"),
    "passing": Case(
        inputs="passing",
        commands="""
            estimate passing.h5
            report passing.layers.h5
            export passing.layers.h5 -o sure.csv
            export passing.layers.h5 -o all.csv --suspect --fields suspect
            surfaces passing.layers.h5 --suspect
        """,
    ),
    "filtered": Case(inputs="filtered", commands="estimate filtered.h5\ninfo filtered.layers.h5"),
    "pinhole": Case(
        inputs="pinhole",
        commands="""
            estimate pinhole.h5
            surfaces pinhole.layers.h5 --factor 4
            export pinhole.layers.h5 -o points.ply
            export pinhole.layers.h5 -o points.pcd --fields amplitude
            export pinhole.layers.h5 -o points.pcd --fields n_samples,mixing
            export pinhole.layers.h5 -o points.laz --min-weight 0.1
            export pinhole.layers.h5 -o near.tif --scale 0.25
            export pinhole.surfaces.h5 -o edges.geojson
            export pinhole.surfaces.h5 -o edges.obj
            export pinhole.surfaces.h5 -o fine.png
            export pinhole.surfaces.h5 -o fine.csv --what points
            map pinhole.layers.h5 -o map.yaml --voxels map.npz
        """,
    ),
    "ball": Case(
        inputs="ball",
        commands="""
            estimate ball.h5
            surfaces ball.layers.h5
            info ball.surfaces.h5 --json
            report ball.layers.h5 --surfaces ball.surfaces.h5 --html page.html
        """,
    ),
    "sums": Case(
        inputs="lock_in",
        commands="""
            estimate sums.h5
            report sums.layers.h5 --recording sums.h5 --html page.html
            inspect sums.layers.h5 --pixel 4,16 --recording sums.h5 -o pixel.svg
            surfaces sums.layers.h5
            map sums.layers.h5 -o map.yaml
            export sums.surfaces.h5 -o planes.json --what planes
            export sums.surfaces.h5 -o planes.obj --what planes
            export sums.surfaces.h5 -o edges.ply
            export sums.layers.h5 -o points.csv --undecided
            estimate sums.h5 -o events.layers.h5 --mixing events
            compare sums.layers.h5 events.layers.h5 --json
        """,
    ),
    "stray": Case(inputs="lock_in", commands="estimate stray.h5 --mixing phasor\nreport stray.layers.h5 --json"),
    "averaged": Case(
        inputs="averaged", commands="estimate averaged.h5\nestimate averaged.h5 --force --overwrite\ninfo averaged.h5"
    ),
    "damaged": Case(
        inputs="damaged",
        commands="""
            verify whole.h5 cut.h5 no.h5 none.h5
            estimate cut.h5
            estimate no.h5
            estimate whole.h5 -o .
            estimate whole.h5 --max-layers 0
            report whole.h5
            inspect whole.h5 --pixel 1,1
            simulate whole.h5 -o x.h5
        """,
    ),
    "sources": Case(
        inputs="sources",
        commands="""
            import depth.npy -o npy.h5 --fov 20x16 --frame-rate 25
            import depth.npz -o npz.h5 --dataset depth --amplitude amplitude --modulation-frequency 20e6
            import depth.tif -o tif.h5 --intrinsics 20,20,3.5,2.5
            import images -o images.h5 --fov 20x16 --scale 0.25
            import depth.mat -o mat.h5 --axes row,col,frame --sensor sr3000
            import other.h5 -o hdf5.h5 --invalid 1.2
            import frames.csv -o frames.h5 --shape 6x8
            import log.csv -o log.h5 --columns n=frame,y=row,x=col,mm=range,ms=time,code=status --time-unit ms \
              --valid-status status=5
            import bag_mcap -o bag.h5 --json
            import depth.npy -o no.h5 --axes row,col
            info depth.npy
            info frames.csv
            info images
            verify npy.h5 tif.h5 log.h5 bag.h5
        """,
    ),
    "plain model": Case(
        inputs="models",
        commands="""
            simulate plain.toml -o plain.h5
            simulate plain.toml -o averaged.h5 --averaged --frames 5
            simulate lens.toml -o lens.h5 --frames 10
            simulate plain.toml --explain
            simulate plain.toml --print-model
            info lens.toml
            verify plain.toml plain.h5
        """,
    ),
    "effects": Case(
        inputs="models",
        commands="""
            simulate biases.toml -o biases.h5
            simulate light.toml -o light.h5 --json
            simulate losses.toml -o losses.h5 --seed 9
            simulate biases.toml --explain
            simulate light.toml --explain
            simulate losses.toml --explain
            info losses.toml --json
        """,
    ),
    "built in": Case(
        inputs="",
        commands="""
            simulate --list
            simulate corridor -o corridor.h5 --frames 2
            sensors
            sensors vl53l5cx
            sensors azure-kinect-nfov --toml
            sensors sr3000 --json
            sensors none
            --help
        """,
    ),
    "wiggling": Case(
        inputs="gaps",
        commands=f"""
            reconcile gap.toml wiggles.h5 -o gap {_GAP}
            verify gap
            info gap
            simulate gap/model.toml -o refined.h5 --frames 5
        """,
    ),
    "pattern": Case(inputs="gaps", commands=f"reconcile gap.toml pattern.h5 -o gap {_GAP} --split frames"),
    "agreement": Case(inputs="gaps", commands=f"reconcile gap.toml agrees.h5 -o gap {_GAP}"),
    "few pixels": Case(
        inputs="small",
        commands="""
            estimate small.h5 --max-layers 3
            surfaces small.layers.h5 --factor 2
            report small.layers.h5 --json
            export small.layers.h5 -o points.csv
            map small.layers.h5 -o map.yaml --cell 200
        """,
        is_stored=True,
    ),
    "few frames": Case(
        inputs="models",
        commands="""
            simulate plain.toml -o plain.h5 --frames 2 --json
            simulate biases.toml -o biases.h5 --frames 2
        """,
        is_stored=True,
    ),
    "few learnt": Case(
        inputs="small",
        commands="""
            estimate small.h5 --noise auto --max-layers 3
            estimate small.h5 -o paper.layers.h5 --paper --max-layers 3
        """,
        is_stored=True,
    ),
}
"""All cases, by name."""
