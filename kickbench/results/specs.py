"""The resolved specs of a run, stored beside its result so that it can be repeated from its folder alone."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from kickbench.experiment import Experiment
from kickbench.results.atomic import atomic_write_text
from kickbench.results.store import RunDirectory
from kickbench.scene.build import has_external_assets
from kickbench.yamlio import Document, dump_yaml


def write_specs(directory: RunDirectory, experiment: Experiment) -> None:
    """Writes task, method, robot, representation table and MJCF.

    What `extends` and `--set` contributed is merged in. The MJCF is copied if it stands alone; one that needs
    mesh or texture files is named by a path relative to the copy.
    """
    task, method = experiment.loaded_task, experiment.method
    model = Path(task.robot.spec.model)
    if has_external_assets(model):
        model_name = os.path.relpath(model, directory.specs)
    else:
        model_name = directory.robot_xml.name
        atomic_write_text(directory.robot_xml, model.read_text(encoding="utf-8"))
    _write(directory.task_spec, task.document, {"robot": directory.robot_spec.name})
    _write(directory.robot_spec, task.robot.document, {"model": model_name})
    _write(directory.method_spec, method.document, {"representations": directory.representations_spec.name})
    _write(directory.representations_spec, method.representations.document, {})


def _write(path: Path, document: Document, paths: dict[str, Any]) -> None:
    atomic_write_text(path, dump_yaml({**document.data, **paths}))
