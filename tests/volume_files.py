"""Valid files of volumes: arrays and lists of voxels."""

import io

import numpy as np


def array_files() -> list[bytes]:
    rng, files = np.random.default_rng(0), []
    for shape, kind in (((30,), bool), ((6, 5), np.uint8), ((4, 5, 6), bool), ((3, 2, 3, 2), np.int64)):
        buffer = io.BytesIO()
        np.save(buffer, (rng.random(shape) < 0.7).astype(kind))
        files.append(buffer.getvalue())
    return files


VOXELS = "voxel 12 9 6\n" + "".join(f"{i} {i * i % 9} {i % 6}\n" for i in range(12))
