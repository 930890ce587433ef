"""Makes the section models that come with cosim again: python benchmarks/section_models.py, two minutes of
CPU time for each. Needed when a test says that one is not that of today's robot, options or method.
"""

import os
import tempfile

os.environ.setdefault("OMP_NUM_THREADS", "1")

from cosim.base import state_file
from cosim.build import section_models
from cosim.config.loading import load_scenario


def main() -> None:
    """Build all, replace those in the package, and print their errors."""
    folder = section_models.FOLDER
    folder.mkdir(exist_ok=True)
    for path in folder.glob("*.npz"):
        path.unlink()
    with tempfile.TemporaryDirectory() as cache:  # so that each is built
        os.environ["COSIM_CACHE_DIR"] = cache
        for name in section_models.SHIPPED:
            scenario = load_scenario(name, {"fidelity": "section"})
            model = section_models.section_model(scenario, print)
            state_file.save(section_models.shipped_path(scenario), model)
            print(f"{name}: {model.samples} samples, tip within {1e2 * model.tip_error:.2f} % of the length")


if __name__ == "__main__":
    main()
