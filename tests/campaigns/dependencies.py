"""Licence, size and import time of every package that an installation asks for: python -m tests.campaigns.dependencies

Prints the table of rig/README.md. Sizes are those of the files that the package itself installed, without what it
depends on; seconds are the median of three imports in fresh processes, with what it depends on.
"""

import re
import statistics
import subprocess
import sys
from importlib.metadata import Distribution, distribution, requires

REASONS = {
    "asammdf": "MDF4 files (`mdf`)",
    "bokeh": "plots to zoom on the pages",
    "distributed": "campaigns on many computers (`cluster`)",
    "exudyn": "the plant `ancf` (`simulate`)",
    "h5py": "HDF5 and MATLAB 7.3 files (`lab`)",
    "jaxtyping": "shapes of arrays in signatures, checked in tests",
    "joblib": "null simulations and plans over processes",
    "lz4": "compression of MCAP chunks",
    "matplotlib": "figures as PNG",
    "mcap": "recordings",
    "msgspec": "JSON and TOML read into types",
    "nptdms": "LabVIEW's files (`lab`)",
    "numba": "compiled loops of the plants",
    "numpy": "arrays",
    "protobuf": "messages in MCAP that other programs read",
    "pyoperon": "symbolic regression of laws (`symbolic`)",
    "pythonfmu3": "rigs as FMU (`fmu`)",
    "pyuff": "universal files (`lab`)",
    "rerun-sdk": "the viewer (`view`)",
    "rich": "tables and progress in the terminal",
    "scipy": "transforms, sparse equations, statistics",
    "threadpoolctl": "one thread a task",
    "typer": "the command line",
    "zlib-ng": "checksums and compression, fast",
    "zstandard": "compression of MCAP chunks",
}
MODULES = {"protobuf": "google.protobuf.message", "rerun-sdk": "rerun", "zlib-ng": "zlib_ng.zlib_ng"}
"""What is imported of a package whose module is named otherwise."""
IMPORTS = 3


def main() -> None:
    print("| package | what for | licence | MB | import, s |\n|---|---|---|---|---|")
    for name in packages():
        found = distribution(name)
        print(f"| {name} | {REASONS[name]} | {licence(found)} | {size_mb(found):.1f} | {import_s(name):.2f} |")


def packages() -> list[str]:
    """Names of the packages of the core and of all extras of use, without those of tests and documentation."""
    wanted = (requirement for requirement in requires("rig-identify") or () if not _is_for_development(requirement))
    return sorted({re.split(r"[^\w.-]", requirement)[0].lower() for requirement in wanted} - {"rig-identify"})


def licence(package: Distribution) -> str:
    """SPDX expression of a package, else the licence that its classifiers or its metadata name."""
    classifiers = (c.rpartition(" :: ")[2] for c in package.metadata.get_all("Classifier") or () if "License ::" in c)
    stated = package.metadata["License-Expression"] or next(classifiers, None) or package.metadata["License"]
    return (stated or "not stated").splitlines()[0]


def size_mb(package: Distribution) -> float:
    """Size of the files that a package installed."""
    return sum(file.size or 0 for file in package.files or ()) / 1e6


def import_s(name: str) -> float:
    """Seconds to import a package in a fresh process, the median of three."""
    module = MODULES.get(name, name.replace("-", "_"))
    code = f"import time; start = time.perf_counter(); import {module}; print(time.perf_counter() - start)"
    return statistics.median(_printed_s(code) for _ in range(IMPORTS))


def _printed_s(code: str) -> float:
    return float(subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout)


def _is_for_development(requirement: str) -> bool:
    return any(f'extra == "{extra}"' in requirement for extra in ("test", "docs"))


if __name__ == "__main__":
    main()
