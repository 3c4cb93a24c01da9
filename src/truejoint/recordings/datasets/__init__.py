"""Public recordings of real joints: what there is, where it is, how to get and open it."""

from truejoint.recordings.datasets.catalogue import (
    DATASETS,
    Dataset,
    DatasetFile,
    DatasetRecording,
    HeldOut,
    get_dataset,
)
from truejoint.recordings.datasets.store import (
    DATA_VARIABLE,
    cache_folder,
    data_folders,
    fetch,
    locate,
    open_dataset,
)

__all__ = [
    "DATASETS",
    "DATA_VARIABLE",
    "Dataset",
    "DatasetFile",
    "DatasetRecording",
    "HeldOut",
    "cache_folder",
    "data_folders",
    "fetch",
    "get_dataset",
    "locate",
    "open_dataset",
]
