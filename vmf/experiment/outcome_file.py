"""A trial's outcome as the content of a file, in which a later call finds it."""

from __future__ import annotations

import json
from io import BytesIO
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from vmf.errors import Loss
from vmf.experiment.trial import Outcome

_KEY = b"vmf.outcome"


def to_bytes(outcome: Outcome) -> bytes:
    """Return the outcome as Parquet: the error table, with the rest in its metadata; the model apart."""
    more = {
        "counts": outcome.counts.tolist(),
        "condition": outcome.condition.tolist(),
        "updates": outcome.updates.tolist(),
        "points": outcome.points.tolist(),
        "losses": outcome.losses,
        "data_losses": [[loss.place, loss.what, loss.count] for loss in outcome.data_losses],
    }
    table = pa.Table.from_pandas(outcome.errors, preserve_index=False)
    table = table.replace_schema_metadata({**table.schema.metadata, _KEY: json.dumps(more).encode()})
    buffer = BytesIO()
    pq.write_table(table, buffer)
    return buffer.getvalue()


def load(path: Path) -> Outcome:
    """Read what `to_bytes` made."""
    table = pq.ParquetFile(path).read(use_threads=False)
    more = json.loads(table.schema.metadata[_KEY])
    # Names are few and rows are many: 100 trials of 2000 frames have millions.
    text = pa.string(), pa.large_string()
    names = [field.name for field in table.schema if field.type in text]
    return Outcome(
        table.to_pandas(categories=names),
        np.array(more["counts"], np.int64),
        np.array(more["condition"], float),
        np.array(more["updates"], float).reshape(-1, 4),
        tuple(more["losses"]),
        tuple(Loss(*loss) for loss in more["data_losses"]),
        points=np.array(more["points"], float).reshape(-1, 3),
    )
