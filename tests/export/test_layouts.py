"""What else lies in a bundle: a library for Arduino, a block as CMSIS-DSP has, and what make reports, or needs."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import numpy as np
import pytest

from becalm.cleaning.recipes.recipe_parts import LimitsRecipe
from becalm.core.arrays import Floats
from becalm.export.bundle import Bundle, Exported
from becalm.export.layouts import library_name
from becalm.export.proof.compiling import STRICT
from becalm.export.proof.verifying import write_bundle
from exported import bundle, channel, need

CHANNELS = (channel("ax", 2, 0.05), channel("ay", 1, 0.02, limits=LimitsRecipe(low=-1.0, high=4095.0)))
SPANS = dict.fromkeys((told.name for told in CHANNELS), (-1.0, 4095.0))
ARDUINO_H = """
#pragma once
#include <cstdint>
#include <cstdio>
enum { A0 = 14 };
inline unsigned long fake_us = 0;
inline int fake_row = 0;
inline unsigned long micros() { return fake_us; }
inline int analogRead(int pin) { return 512 + (37 * fake_row + 11 * (pin - A0)) % 101; }
struct FakeSerial {
    void begin(unsigned long) {}
    void print(const char *text) { std::printf("%s", text); }
    void print(int number) { std::printf("%d", number); }
    void print(long number) { std::printf("%ld", number); }
    void print(double number, int digits) { std::printf("%.*f", digits, number); }
};
inline FakeSerial Serial;
"""
SKETCH_MAIN = """
#include "DriveLive.ino"
int main()
{
    fake_us = 4294000000ul; // micros() begins anew after 2^32 us
    setup();
    for (int turn = 0; turn < 4000; turn++) {
        fake_us = (fake_us + ((turn == 2000) ? 70000ul : 2500ul)) & 0xFFFFFFFFul;
        fake_row = turn;
        loop();
    }
    return 0;
}
"""
BLOCK_MAIN = """
#include "cmsis_block.c"
#include <stdio.h>
int main(void)
{
    drive_blocks_init();
    for (uint32_t row = 0u; row < 640u; row++) {
        const uint32_t at = row % 64u;
        drive_dma[2u * at] = (uint16_t)(512u + (37u * row) % 101u);
        drive_dma[2u * at + 1u] = (uint16_t)(512u + (37u * row + 11u) % 101u);
        if ((at == 31u) || (at == 63u)) {
            (at == 31u) ? drive_half_callback() : drive_full_callback();
            for (uint32_t told = 0u; told < DRIVE_BLOCK; told++) {
                printf("%.17g %.17g\\n", (double)drive_ax_output[told], (double)drive_ay_output[told]);
            }
        }
    }
    printf("%lu %lu\\n", (unsigned long)drive_ax_its_block.left_out, (unsigned long)drive_ay_its_block.left_out);
    return 0;
}
"""


@pytest.fixture(scope="module", params=["float32", "float64", "q31"])
def made(request: pytest.FixtureRequest) -> Bundle:
    """Write two channels."""
    return bundle(*CHANNELS, precision=request.param, spans=SPANS if request.param == "q31" else {})


@pytest.fixture
def folder(made: Bundle, tmp_path: Path) -> Path:
    """Unpack them."""
    return write_bundle(made, tmp_path)


def ran(*words: object, expect: int = 0, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    """Run a program that has to end so."""
    need(str(words[0]))
    done = subprocess.run(
        [str(word) for word in words], capture_output=True, text=True, check=False, timeout=300, cwd=cwd
    )
    assert done.returncode == expect, done.stdout + done.stderr
    return done


def test_the_block_counts_the_readings_that_were_not_used(folder: Path) -> None:
    header, example = ((folder / name).read_text(encoding="utf-8") for name in ("becalm.h", "examples/cmsis_block.c"))
    used = set(re.findall(r"(BECALM_\w+) = \d+,? +/\* used", header))
    assert len(used) == 5
    assert used == set(re.findall(r"case (BECALM_\w+):", example))


def counts(rows: int, place: int) -> Floats:
    """Return what the stubs read at a place."""
    return np.asarray(512.0 + (37 * np.arange(rows) + 11 * place) % 101, np.float64)


def wanted(one: Exported, told: Floats, gap: tuple[int, int] | None = None) -> Floats:
    """Return what the specification makes of numbers (N,) that C is given; a gap is before which row, and how long."""
    (recipe,) = (each for each in CHANNELS if each.name == one.name)
    reference = one.kind.reference(recipe, one.design, one.written)
    readings = one.kind.in_unit(told.astype(one.kind.raw(told, one.written).dtype), one.written)
    if gap is None:
        return one.kind.counts(reference.run(readings)[0], one.written)
    before = reference.run(readings[: gap[0]])[0]
    reference.gap(gap[1])
    return one.kind.counts(np.concatenate([before, reference.run(readings[gap[0] :])[0]]), one.written)


def rounds(one: Exported, otherwise: float) -> float:
    """Return what a signal may be off by: two counts in fixed point."""
    return 2.0 if one.kind.number.precision == "q31" else otherwise


def test_a_library_is_named_as_arduino_asks() -> None:
    assert library_name("drive") == "Drive"
    assert library_name("test_bench_2") == "TestBench2"
    assert re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9 _.-]{0,62}", library_name("a" * 40))


def test_an_arduino_library_has_what_arduino_asks_for(made: Bundle) -> None:
    files = made.files
    told = dict(line.split("=", 1) for line in files["arduino/Drive/library.properties"].splitlines())
    asked = "name version author maintainer sentence paragraph category url architectures includes"
    assert list(told) == asked.split()
    assert re.fullmatch(r"\d+\.\d+\.\d+", told["version"])
    for name in ("becalm.h", "drive.h", "drive.c"):
        assert files[f"arduino/Drive/src/{name}"] == files[name]
    keywords = dict(line.split("\t") for line in files["arduino/Drive/keywords.txt"].splitlines())
    functions = re.findall(r"^[\w ]+ \**(drive_\w+)\(", files["drive.h"], re.M)
    assert {name for name, kind in keywords.items() if kind == "KEYWORD2"} == set(functions)
    statuses = re.findall(r"^    (BECALM_\w+) =", files["becalm.h"], re.M)
    assert {name for name, kind in keywords.items() if kind == "LITERAL1"} == set(statuses)


def test_the_sketch_filters_as_the_specification_does(made: Bundle, folder: Path) -> None:
    library, stub = folder / "arduino/Drive", folder / "stub"
    stub.mkdir()
    (stub / "Arduino.h").write_text(ARDUINO_H)
    (stub / "main.cpp").write_text(SKETCH_MAIN)
    strict = ("-Wall", "-Wextra", "-Wconversion", "-Werror", "-std=c++17")
    places = (f"-I{stub}", f"-I{library / 'src'}", f"-I{library / 'examples/DriveLive'}")
    ran("gcc", *STRICT, "-c", library / "src/drive.c", "-o", stub / "drive.o")
    ran("g++", *strict, *places, "-c", stub / "main.cpp", "-o", stub / "main.o")
    ran("g++", stub / "main.o", stub / "drive.o", "-o", stub / "sketch")
    rows = [dict(cell.split(":") for cell in line.split("\t")) for line in ran(stub / "sketch").stdout.splitlines()]
    # 4 turns a sample; turn 2000 takes 70 ms, so that its sample comes 6 late
    at = [int(row["drive_ax_status"]) for row in rows]
    assert len(at) == 999 + 1
    for place, one in enumerate(made.channels):
        readings = np.array([float(row[f"{one.prefix}_reading"]) for row in rows])
        np.testing.assert_array_equal(readings[:500], 512.0 + (37 * (4 * np.arange(500) + 3) + 11 * place) % 101)
        told = np.array([float(row[f"{one.prefix}_signal"]) for row in rows])
        np.testing.assert_allclose(told, wanted(one, readings, (500, 6)), rtol=0, atol=rounds(one, 2e-3))


@pytest.mark.parametrize("compiler", ["gcc", "clang"])
def test_a_block_filters_as_the_specification_does(made: Bundle, folder: Path, compiler: str) -> None:
    ran(compiler, *STRICT, "-O2", f"-I{folder}", "-c", folder / "examples/cmsis_block.c", "-o", folder / "block.o")
    (folder / "main_of_block.c").write_text(BLOCK_MAIN)
    program = folder / "block"
    places = (f"-I{folder}", f"-I{folder / 'examples'}")
    ran(compiler, *STRICT, *places, folder / "main_of_block.c", folder / "drive.c", "-o", program)
    *lines, left_out = ran(program).stdout.splitlines()
    told = np.array([line.split() for line in lines], float)
    assert left_out == "0 0"
    for place, one in enumerate(made.channels):
        np.testing.assert_allclose(told[:, place], wanted(one, counts(640, place)), rtol=0, atol=rounds(one, 2e-3))


def test_make_compiles_the_examples(folder: Path) -> None:
    ran("make", "-C", folder, "examples")


def test_every_line_is_reached_by_the_golden_vectors(folder: Path) -> None:
    need("gcov")
    said = ran("make", "-C", folder, "coverage").stdout
    (found,) = re.findall(r"drive\.c'\nLines executed:([\d.]+)%", said)
    assert float(found) == 100.0, "\n".join(line for line in said.splitlines() if "#####" in line)


NEEDS = {
    "cortex-m": ("ARM_CC", "gcc-arm-none-eabi"),
    "cortex-m0": ("ARM_CC", "gcc-arm-none-eabi"),
    "cortex-m-count": ("ARM_CC", "gcc-arm-none-eabi"),
    "misra": ("CPPCHECK", "cppcheck"),
    "coverage": ("GCOV", "gcc"),
}
"""The program of each target of make, and its package."""


def test_a_missing_tool_is_said_and_only_where_it_is_asked_for(folder: Path) -> None:
    ran("make", "-C", folder, "check", "CFLAGS=-O0", *(f"{variable}=no-such-tool" for variable, _ in NEEDS.values()))
    for target, (variable, package) in NEEDS.items():
        said = ran("make", "-C", folder, target, f"{variable}=no-such-tool", expect=2).stderr
        assert "needs no-such-tool, which is not installed here" in said
        assert f"apt-get install {package}" in said
