"""Runs the notebooks of ``fits/notebooks`` in place: ``python fits/run_notebooks.py``.

Outputs contain nothing that changes between runs or machines: no times, versions or
paths. A notebook that fails or warns is not changed.
"""

import base64
import io
import json
import os
import sys
import tempfile
from pathlib import Path

import nbformat
from jupyter_client import AsyncKernelManager
from jupyter_client.kernelspec import KernelSpecManager
from nbclient import NotebookClient
from PIL import Image

from tirefit.files import replacing

NOTEBOOKS = Path(__file__).parent / "notebooks"

_KERNEL = {"display_name": "Python 3 (ipykernel)", "language": "python"}
_METADATA = {"kernelspec": {**_KERNEL, "name": "python3"}, "language_info": {"name": "python"}}


def execute(path: Path, **environment: str) -> nbformat.NotebookNode:
    """The notebook with fresh outputs, run in its own folder by this interpreter.

    Args:
        path: the notebook; it is read, not written.
        environment: variables of the kernel, in addition to those of this process.

    Raises:
        CellExecutionError: a cell raised.
        ValueError: a cell wrote to stderr, for example a warning.
    """
    notebook = nbformat.read(path, as_version=4)
    with tempfile.TemporaryDirectory() as scratch:
        kernel = Path(scratch, "kernels", "python3")
        kernel.mkdir(parents=True)
        command = [sys.executable, "-m", "ipykernel_launcher", "-f"]
        spec = {"argv": [*command, "{connection_file}"], **_KERNEL}
        kernel.joinpath("kernel.json").write_text(json.dumps(spec))
        # No start-up files and no history of the user's; inline figures.
        inherited = {k: v for k, v in os.environ.items() if k != "MPLBACKEND"}
        environment = inherited | {"IPYTHONDIR": scratch} | environment
        specs = KernelSpecManager(kernel_dirs=[str(kernel.parent)], ensure_native_kernel=False)
        manager = AsyncKernelManager(
            kernel_name="python3",
            kernel_spec_manager=specs,
            shutdown_wait_time=2.0,
            # Sockets on disk if available: a port is open to everyone.
            transport="ipc" if os.name == "posix" else "tcp",
            connection_file=str(Path(scratch, "kernel.json")),
        )
        client = NotebookClient(
            notebook,
            km=manager,
            timeout=600,
            record_timing=False,
            coalesce_streams=True,
            resources={"metadata": {"path": str(path.parent)}},
        )
        client.execute(env=environment, cleanup_kc=True)
    _clean(notebook)
    return notebook


def _clean(notebook: nbformat.NotebookNode) -> None:
    """Remove machine-dependent output and shrink figures; refuse warnings."""
    notebook.metadata = nbformat.from_dict(_METADATA)
    for cell in notebook.cells:
        cell.metadata = nbformat.from_dict({})
        for output in cell.get("outputs", []):
            if output.get("name") == "stderr":
                raise ValueError(f"a cell wrote to stderr:\n{output.text}")
            if "metadata" in output:
                output.metadata = nbformat.from_dict({})
            if "image/png" in output.get("data", {}):
                output.data["image/png"] = _compact(output.data["image/png"])


def _compact(picture: str) -> str:
    """The picture (base64 PNG) in 64 colours, with less than a third of the size."""
    image = Image.open(io.BytesIO(base64.b64decode(picture)))
    small = io.BytesIO()
    image.convert("RGB").quantize(64, dither=Image.Dither.NONE).save(
        small, format="png", optimize=True
    )
    return base64.b64encode(small.getvalue()).decode("ascii")


def main() -> None:
    for path in sorted(NOTEBOOKS.glob("*.ipynb")):
        notebook = execute(path)
        with replacing(path) as temporary:
            nbformat.write(notebook, temporary)
        print(f"{path.name}: {path.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
