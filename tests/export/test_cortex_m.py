"""What is exported, on emulated Cortex-Ms: the golden vectors, and the instructions a sample takes."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path
from typing import Any

import pytest

from becalm.cleaning.recipes.recipe import ChannelRecipe
from becalm.cleaning.recipes.recipe_parts import GateRecipe
from becalm.export.proof.verifying import write_bundle
from exported import MODES, TONE, WIDE_LIMITS, bundle, channel, need

pytestmark = pytest.mark.slow

SLOPE, LEVEL = channel("ax", 2, 0.05), channel("ay", 1, 1e-3, limits=WIDE_LIMITS)
CHANNELS = (SLOPE, LEVEL, channel("az", 3, 0.02, tone=(TONE,)))
SPANS = {told.name: (-500.0, 500.0) for told in CHANNELS}
KINDS: dict[str, tuple[tuple[ChannelRecipe, ...], dict[str, Any]]] = {
    "float32": (CHANNELS, {}),
    "float64": (CHANNELS, {"precision": "float64"}),
    "q31": (CHANNELS, {"precision": "q31", "spans": SPANS}),
    "covariance": (CHANNELS[1:], {"gain": "full"}),
    "gate": ((channel("ax", 2, 0.05, gate=GateRecipe()),), {}),
    "modes": ((channel("ax", 2, 0.05, switching=MODES),), {}),
}
BOARDS = [
    *(("float32", cpu) for cpu in ("m0", "m3", "m4")),
    *(("q31", cpu) for cpu in ("m0", "m4")),
    ("float64", "m0"),
    ("covariance", "m4"),
    ("gate", "m0"),
    ("modes", "m3"),
]
"""float32 on each, which compute it differently; double is software on all, so that each kind is on one of them."""


@pytest.fixture(scope="module", params=BOARDS, ids=" ".join)
def board(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """Write filters of one kind; return their folder, and the CPU."""
    kind, cpu = request.param
    channels, asked = KINDS[kind]
    return write_bundle(bundle(*channels, **asked), tmp_path_factory.mktemp(kind)), cpu


@pytest.fixture
def single(tmp_path: Path) -> Path:
    """Write one channel in float32, to be changed."""
    return write_bundle(bundle(SLOPE), tmp_path)


def make(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """Run make where an ARM compiler and QEMU are here."""
    for program in ("make", "arm-none-eabi-gcc", "qemu-system-arm"):
        need(program)
    command = ["make", "--no-print-directory", "-C", str(folder), *words]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)


def counted(folder: Path, cpu: str) -> dict[str, float]:
    """Return the instructions a sample of each channel takes."""
    ran = make(folder, f"cortex-{cpu}-count")
    assert ran.returncode == 0, ran.stdout + ran.stderr
    return {name: float(many) for name, many in re.findall(r"^(\w+): ([\d.]+) instructions a sample", ran.stdout, re.M)}


def test_golden_vectors_pass_on_a_cortex_m(board: tuple[Path, str]) -> None:
    folder, cpu = board
    ran = make(folder, f"cortex-{cpu}")
    assert ran.returncode == 0, ran.stdout + ran.stderr
    assert ran.stdout.rstrip().endswith("All vectors and checks passed.")
    assert len(re.findall(r"^drive_\w+ \w+ +passed:", ran.stdout, re.M)) == (folder / "main.c").read_text().count(
        "failed += "
    )


def test_a_wrong_number_fails_on_a_cortex_m(single: Path) -> None:
    source = single / "drive.c"
    text = source.read_text()
    wrong = text.replace("const float nu = (z - s->level)", "const float nu = 1.001f * (z - s->level)")
    assert wrong != text
    source.write_text(wrong)
    ran = make(single, "cortex-m")
    assert ran.returncode != 0
    assert "FAILED" in ran.stdout
    assert "vectors or checks failed" in ran.stdout


def test_a_fault_ends_the_emulation_and_fails(single: Path) -> None:
    (single / "main.c").write_text(
        "#include <stdint.h>\nint main(void) { *(volatile uint32_t *)0xA0000000u = 1u; return 0; }\n"
    )
    ran = make(single, "cortex-m0")
    assert ran.returncode != 0
    assert "The processor has faulted." in ran.stdout


def test_no_library_is_needed_but_memset_memcpy_roots_and_arithmetic(board: tuple[Path, str]) -> None:
    folder, cpu = board
    need("arm-none-eabi-nm")
    texts = ["drive.c", *(f"native/{path.name}" for path in sorted(folder.glob("native/*.c")))]
    objects = [f"build/cortex_{cpu}/{text.removesuffix('.c')}.o" for text in texts]
    made = make(folder, *objects)
    assert made.returncode == 0, made.stderr
    words = ["arm-none-eabi-nm", *(str(folder / one) for one in objects)]
    listed = subprocess.run(words, capture_output=True, text=True, check=True).stdout
    defined = set(re.findall(r"^\w+ T (\w+)$", listed, re.M))
    more = {"sqrt", "memmove"} if len(objects) > 1 else set()  # a loop that copies may become the second
    needed = set(re.findall(r"^ +U (\w+)$", listed, re.M)) - defined - {"memset", "memcpy"} - more
    assert not {name for name in needed if not name.startswith("__aeabi_")}


def test_every_channel_is_counted(board: tuple[Path, str]) -> None:
    folder, cpu = board
    found = counted(folder, cpu)
    assert list(found) == re.findall(r"^void (\w+)_init\(", (folder / "drive.h").read_text(), re.M)
    assert all(10 < many < 1_000_000 for many in found.values())  # modes, in double by software: 110 000 and more


@pytest.mark.parametrize("cpu", ["m0", "m4"])
def test_seven_instructions_more_are_counted_as_seven(single: Path, cpu: str) -> None:
    before = counted(single, cpu)["drive_ax"]
    source = single / "drive.c"
    head, block, rest = source.read_text().partition("_step_block(")
    loop = "row++) {\n"
    assert loop in rest
    rest = rest.replace(
        loop, loop + '        __asm__ volatile("nop\\n\\tnop\\n\\tnop\\n\\tnop\\n\\tnop\\n\\tnop\\n\\tnop");\n', 1
    )
    source.write_text(head + block + rest)
    assert counted(single, cpu)["drive_ax"] == pytest.approx(before + 7, abs=0.11)


def test_without_counted_time_nothing_is_counted(single: Path) -> None:
    ran = make(single, "cortex-m4-count", "QEMU_COUNTING=")
    assert ran.returncode != 0
    assert "was counted wrongly" in ran.stdout
    assert "instructions a sample" not in ran.stdout
