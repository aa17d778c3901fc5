"""Lines of product Python by folder and by feature: the tables of docs/size.md.

python benchmarks/size.py docs/size.md
"""

import sys
from pathlib import Path

ROOT = Path(__file__).parent.parent

FOLDERS = {
    "kernels": (["kernels"], 2043),
    "testcases": (["testcases"], 2476),
    "mesh": (["swe_sphere/mesh"], 596),
    "operators": (["swe_sphere/operators"], 742),
    "equations": (["swe_sphere/equations"], 1491),
    "solvers": (["swe_sphere/solvers"], 1882 + 412),
    "steppers": (["swe_sphere/steppers"], 2067),
    "simulation": (["swe_sphere/simulation"], 811 + 892),
    "io, pictures, analysis": ([f"swe_sphere/{n}" for n in ("io", "pictures", "analysis")], 1842),
    "studies": (["swe_sphere/studies"], 2594 + 2508 + 1796 + 2012),
    "cli": (["swe_sphere/cli"], 1113),
    "all else": (["swe_sphere"], 112),
}
"""Where lines are counted, and how many there were in commit 8e73fdc, 2026-11-22."""

FEATURES = {
    "Runs in several processes (MPI)": "parallel messages kernels/messages cli/ranks"
    " mesh/partition operators/exchange operators/halo operators/part_layout"
    " solvers/preconditioners/coarse_part",
    "Exponential steppers": "steppers/exponential solvers/krylov_exponential",
    "Multirate steppers": "steppers/multirate equations/fast_waves kernels/fast_waves",
    "Forward-backward steppers": "steppers/forward_backward equations/passes"
    " kernels/forward_backward kernels/run_steps",
    "Tracers on steps of their own": "steppers/tracer_steps steppers/tracer_stages"
    " operators/tracer_step_operator kernels/tracer_step",
    "Diffusion apart, implicitly": "steppers/split_diffusion operators/damping kernels/damping",
    "Preconditioner of the whole Jacobian": "solvers/preconditioners/jacobian_direct",
    "Map of regimes, advice, claims of others": "studies/regimes/* studies/advice/*"
    " cli/advise studies/report/claims",
    "Ensembles": "studies/ensemble cli/ensemble",
    "Modelled times": "studies/costs operators/work",
    "Runs of a study beside each other": "studies/jobs",
    "Python API, callbacks, diagnostics of one's own": "simulation/simulation"
    " simulation/callbacks simulation/diagnostics simulation/supplied registry",
    "Analysis and regridding": "analysis/* mesh/cells",
    "Films, overlays, pictures in the terminal": "pictures/animate pictures/overlays"
    " simulation/live",
    "Zarr, files that grow and stay whole": "io/zarr_store io/classic io/growing",
    "Tides, planetary waves, relaxed jet": "testcases/tide testcases/relaxed_jet",
    "Registers of CPUs, stages in one kernel, recorded launches": "kernels/access"
    " kernels/registers kernels/sums kernels/stages operators/replay operators/sliced_matrix"
    " operators/tall_matrix",
}
"""Files that do nothing else than what the program could not do then."""


def files(names: str) -> list[Path]:
    """The files of a feature; each name must find some."""
    found: list[Path] = []
    for name in names.split():
        places = (ROOT, ROOT / "swe_sphere")
        of_name = [path for place in places for path in sorted(place.glob(f"{name}.py"))]
        if not of_name:
            sys.exit(f"{name}: there is no such file: mend FEATURES")
        found += of_name
    return found


def lines(path: Path) -> int:
    """What `wc -l` counts."""
    return path.read_bytes().count(b"\n")


def page() -> str:
    """Both tables, with what they mean."""
    features = {title: files(names) for title, names in FEATURES.items()}
    new = {path for found in features.values() for path in found}
    counted: set[Path] = set()
    rows, total = [], [0, 0, 0]
    for title, (places, before) in FOLDERS.items():
        here = {path for place in places for path in (ROOT / place).rglob("*.py")} - counted
        counted |= here
        numbers = before, sum(map(lines, here)), sum(map(lines, here & new))
        rows.append((title, *numbers))
        total = [a + b for a, b in zip(total, numbers, strict=True)]
    table = [
        f"| {title} | {before} | {now} | {of_new} | {now - of_new} |"
        for title, before, now, of_new in [*rows, ("**all**", *total)]
    ]
    by_feature = [f"| {title} | {sum(map(lines, each))} |" for title, each in features.items()]
    toml = sum(map(lines, (ROOT / "swe_sphere").rglob("*.toml")))
    return TEXT.format(folders="\n".join(table), features="\n".join(by_feature), toml=toml)


TEXT = """# Size of the code

Lines of product Python, as `wc -l` counts them, docstrings and blank lines included.  "Then" is
22 November 2026, before there were a Python API and the features of the second table; folders that
were joined since are added up.  A file is of a new feature only if it does nothing else, by what
its first line says.  What old files have grown by, to serve new features (ranks and tracer steps in
the mesh on the device, say) or to be faster, stricter or more exact, is in the last column: it is
an upper bound of what the old features take today.  What was code then and is data now, the
bounds of verification and of the stress trials, is not counted: {toml} lines of TOML, 74 then.

| folder | then | now | in files of new features | the rest |
|---|---|---|---|---|
{folders}

| new since then | lines |
|---|---|
{features}

Made by `python benchmarks/size.py docs/size.md`.
"""


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(page(), encoding="utf-8")
