"""The room that a record's run has learned, as found and refined on its training rows."""

from __future__ import annotations

from xfreqbench.data.protocols import find_split
from xfreqbench.errors import DataError
from xfreqbench.methods.virtual_source.refine import Refinement
from xfreqbench.report.findings.compared import ComparedFindings


def refinement_of(compared: ComparedFindings) -> Refinement:
    """The room of a record's findings, and what refines it; its `found` is the room before that.

    Raises `DataError` for findings without faces.
    """
    dataset, job = compared.dataset, compared.record.job
    train = dataset.subset(find_split(dataset, job.protocol, job.split).train)
    refinement = Refinement.of(compared.findings, train)
    if refinement is None:
        raise DataError(
            f"Record {compared.record.id} has no faces from which a room could be made: the run found no plane that "
            "holds anything, or the record was written before faces were stored. Run virtual-source again."
        )
    return refinement
