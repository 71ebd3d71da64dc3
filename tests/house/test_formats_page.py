"""The samples of the page of formats: one for each format that is read, and each holds the same recording."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from format_samples import RATE_HZ, SAMPLES, Sample, signal

from becalm.files import open_source
from becalm.files.decoding import read_bytes
from becalm.files.signatures import LIBRARY_FORMATS

ROWS = 60
NO_WRITER = {"recorders.ide"}  # nothing here writes it; its sample is real


@pytest.mark.parametrize("sample", SAMPLES, ids=lambda sample: sample.name)
def test_every_sample_holds_the_same_recording(sample: Sample, tmp_path: Path) -> None:
    with open_source(sample.make(tmp_path / f"a{sample.endings[0]}", ROWS)) as source:
        found = source.recording()
    assert found.rate_hz == pytest.approx(RATE_HZ)
    columns = np.argsort(found.samples[0]), np.argsort(signal(ROWS)[0])  # MAT 7.3 keeps its own order
    np.testing.assert_allclose(found.samples[:, columns[0]], signal(ROWS)[:, columns[1]], rtol=1e-6)


def test_every_format_has_a_sample(tmp_path: Path) -> None:
    heads = [
        read_bytes(sample.make(tmp_path / f"{n}{sample.endings[0]}", ROWS), 512) for n, sample in enumerate(SAMPLES)
    ]
    without = {one.module for one in LIBRARY_FORMATS if not any(map(one.matches, heads))}
    assert without == NO_WRITER
