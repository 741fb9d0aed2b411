"""Markdown tables, and the sections of RESULTS.md that each benchmark owns."""

from __future__ import annotations

import os
import platform
from pathlib import Path

import pandas as pd

RESULTS = Path(__file__).with_name("RESULTS.md")
SECTIONS = (
    *("accuracy", "speed", "solver", "card", "stress", "mouth", "findings"),
    *("compare", "recognition", "likeness", "study", "corpus", "levels", "validate", "others", "calibration"),
    *("tradeoff_detector", "tradeoff_simulator", "tradeoff_comparison", "regression"),
)


def markdown(table: pd.DataFrame, decimals: int = 2) -> str:
    """A DataFrame as a Markdown table, its index as the first column; NaN becomes a dash."""
    head = [str(table.index.name or ""), *map(str, table.columns)]
    lines = [head, ["---"] * len(head)]
    for name, row in zip(table.index, table.itertuples(index=False), strict=True):
        lines.append([str(name), *(_cell(value, decimals) for value in row)])
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def _cell(value: object, decimals: int) -> str:
    if isinstance(value, str):
        return value
    if pd.isna(value):
        return "-"
    return str(int(value)) if float(value).is_integer() else f"{value:.{decimals}f}"


def write_section(section: str, text: str, file: Path = RESULTS) -> None:
    """Replace one section of RESULTS.md and leave the others as they are."""
    old = file.read_text() if file.exists() else ""
    parts = {name: old.partition(_mark(name))[2].partition(_mark("end"))[0].strip("\n") for name in SECTIONS}
    parts[section] = text.strip("\n")
    whole = "# Results\n\nPrinted by the scripts in this folder (README.md says how); do not edit by hand.\n"
    for name in SECTIONS:
        whole += f"\n{_mark(name)}\n{parts[name]}\n{_mark('end')}\n"
    beside = file.with_suffix(".part")
    beside.write_text(whole)
    os.replace(beside, file)


def _mark(name: str) -> str:
    return f"<!-- {name} -->"


def machine() -> str:
    """Processor, cores and load."""
    model = platform.processor() or platform.machine()
    if Path("/proc/cpuinfo").exists():
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        model = next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), model)
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else float("nan")
    return f"{model}, {os.cpu_count()} cores, load {load:.1f} at the start (1 = one core busy)."
