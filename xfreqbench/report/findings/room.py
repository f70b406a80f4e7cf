"""The room that a record's run has learned, as found and refined on its training rows."""

from __future__ import annotations

from dataclasses import replace

from xfreqbench.data.dataset import PasDataset
from xfreqbench.data.splits import find_split
from xfreqbench.errors import DataError
from xfreqbench.methods.virtual_source.refine import Refinement
from xfreqbench.methods.virtual_source.surfaces import surface_from_json
from xfreqbench.report.findings.compared import ComparedFindings
from xfreqbench.scene.facets import Geometry
from xfreqbench.tracing.image.tracer import can_solve
from xfreqbench.tracing.tracer import TraceSettings


def settings_in_room(dataset: PasDataset) -> TraceSettings:
    """How learned rooms are traced: as the data were, by solver `image`."""
    return replace(dataset.trace_settings, solver="image", materials="extrapolate")


def refinement_of(compared: ComparedFindings) -> Refinement:
    """The room of a record's findings, and what refines it; its `found` is the room before that.

    Where the record tells of the room that the run itself refined, nothing is left to do. Raises `DataError` for
    findings without faces, or data whose interactions the image method does not trace in a room.
    """
    dataset, job = compared.dataset, compared.record.job
    train = dataset.subset(find_split(dataset, job.protocol, job.split).train)
    refinement = Refinement.of(compared.findings, train)
    if refinement is None:
        raise DataError(
            f"Record {compared.record.id} has no faces from which a room could be made: the run found no plane that "
            "holds anything, or the record was written before faces were stored. Run virtual-source again."
        )
    if compared.findings.room:
        refinement.take([surface_from_json(each.model_dump()) for each in compared.findings.room])
    geometry = Geometry([surface.mesh for surface in refinement.room])
    if not can_solve(geometry, settings_in_room(dataset)):
        raise DataError(
            f"{dataset.path} was traced with {', '.join(dataset.trace_settings.interactions)}, which the image method "
            f"does not trace among the {len(refinement.room)} surfaces that were learned. Leave out --room."
        )
    return refinement
