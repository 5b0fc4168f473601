"""The figures of README and site are those of the tables that benchmarks write."""

import re
from collections.abc import Iterator
from decimal import ROUND_HALF_UP, Decimal
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
RIG = "rotors [kg m^2] / Coulomb [N m] / load [kg]"
Row = dict[str, str]


def table(name: str) -> list[Row]:
    """The first table of benchmarks/results/NAME.md: a dictionary a row, by the names of the columns."""
    text = (ROOT / "benchmarks" / "results" / f"{name}.md").read_text("utf-8")
    lines = text[text.index("\n|") + 1 :].split("\n\n")[0].splitlines()
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    return [dict(zip(cells[0], row, strict=True)) for row in cells[2:]]


def pick(name: str, wanted: Row) -> Row:
    """The only row with these values."""
    (found,) = (row for row in table(name) if all(row[column] == value for column, value in wanted.items()))
    return found


def short(number: str, digits: int = 1) -> str:
    """As text has it, with so many digits: 5e-8 for 5e-08, 0.1 for 1.2e-01, 36 for 3.6e+01."""
    value = Decimal(number)
    value = value.quantize(Decimal(1).scaleb(value.adjusted() + 1 - digits), ROUND_HALF_UP)
    if Decimal("0.05") <= value < 1000:
        return f"{float(value):g}"
    return re.sub(r"e([+-])0(\d)", r"e\1\2", f"{float(value):.{digits - 1}e}")


def arrivals() -> Iterator[str]:
    rows = [row for row in table("real_arm") if row["controller"] == "composite"]
    arrived, asked = (sum(int(row["settled"].split("/")[k]) for row in rows) for k in (0, 1))
    assert arrived == asked
    yield f"all of {asked} set-points on {len(rows)} variants"
    yield f"within {max(float(row['worst settling [s]']) for row in rows):.1f} s"


def residues() -> Iterator[str]:
    rows = [row for row in table("real_arm") if row["controller"] == "composite"]
    left = [
        max(float(row["worst steady error [rad]"]) for row in rows if row["noise, delay"] == noise)
        for noise in ("no", "yes")
    ]
    yield f"at most {short(str(left[0]))} rad left ({short(str(left[1]))} with"


def beside_others() -> Iterator[str]:
    said = {
        "composite": ("composite", "no"),
        "composite, noise and delay": ("composite", "yes"),
        "computed torque, URDF": ("computed torque", "no"),
        "PD and the URDF's gravity": ("PD and gravity", "no"),
        "Slotine and Li's composite": ("Slotine-Li", "no"),
    }
    for name, (controller, noise) in said.items():
        cells = []
        for arm in ("panda", "ur5e"):
            found = pick(
                "real_arm", {"arm": arm, RIG: "as it is", "noise, delay": noise, "controller": controller}
            )
            arrived, asked = found["settled"].split("/")
            arrives = "none" if arrived == "0" else f"{arrived} of {asked}"
            error, sines = found["worst steady error [rad]"], found["sines: after 3 s [rad]"]
            cells += [
                re.sub(r"e([+-])0(\d)", r"e\1\2", cell).replace("e+0", "")
                for cell in (f"{arrives}, {error}", sines)
            ]
        yield f"| {name} | {' | '.join(cells)} |".replace("4e+0", "4")


def references() -> Iterator[str]:
    rows = table("tracking")
    assert len(rows) == 12
    assert max(float(row[column]) for row in rows for column in row if "after 3 s" in column) <= 1e-5
    yield "sines in all joints of twelve robots, within 1e-5 rad after three seconds"


def load() -> Iterator[str]:
    kept = {"controller": "composite", "noise": "no"}
    held = pick("payload", {**kept, "event": "attached"})
    moved = pick("payload", {**kept, "event": "attached, home 1 s later"})
    noticed, back = 1e3 * float(held["noticed after [s]"]), held["back below 1e-3 rad after [s]"]
    mass = moved["mass [kg]"].split()[0]
    yield f"noticed after {noticed:.0f} ms, back below 1e-3 rad after {back} s"
    yield f"weighed as {mass} kg after a move"


def loads() -> Iterator[str]:
    for said, controller, noise in (
        ("composite", "composite", "no"),
        ("composite, noise of 1e-4 rad and 1e-3 rad/s", "composite", "yes"),
        ("PD with the URDF's gravity", "PD with the URDF's gravity", "no"),
        ("Slotine and Li's (C4)", "Slotine-Li (C4)", "no"),
    ):
        row = pick("payload", {"controller": controller, "noise": noise, "event": "attached"})
        sags, back = row["sags to [rad]"], row["back below 1e-3 rad after [s]"]
        yield f"| {said} | {sags} | {back} | {short(row['error left [rad]'])} |"


def logs() -> Iterator[str]:
    errors = {row["parameters"]: row["all"] for row in table("identification_peers")}
    yield f"within {errors['eladapt, physical']} % by bodies that can be"
    yield f"by its URDF within {errors['URDF']} %"


def cost() -> Iterator[str]:
    row = pick("step_cost", {"robot": "panda"})
    yield f"{float(row['whole step [us]']):.0f} us a step of a Panda, all {row['l']} parameters learned"


def costs() -> Iterator[str]:
    names = {"two_link": "two_link", "ur5": "ur5", "panda": "panda", "talos, both arms": "TALOS, both arms"}
    for robot, said in names.items():
        row = pick("step_cost", {"robot": robot})
        step, floor = (round(float(row[f"{what} [us]"]) + 1e-6) for what in ("whole step", "floor"))
        above = row["steps above 1 ms"].replace("20000", "20,000")
        yield f"| {said} | {step} | {floor} | {above} |"


def hardware() -> Iterator[str]:
    for said, name in (
        ("noise, 1e-4 rad and 1e-3 rad/s", "noise"),
        ("encoders, 2^17 counts a turn", "encoders"),
        ("delay, 2 ms", "delay"),
        ("noise, encoders and delay", "noise, encoders, delay"),
        ("all of them", "all"),
    ):
        untold, told = (
            pick("hardware_effects", {"hardware": name, "controller": controller})["steady error [rad]"]
            for controller in ("not told", "told")
        )
        yield f"| {said} | {short(untold)} | {short(told)} | "


def mixing() -> Iterator[str]:
    took = {
        name: pick("mixing", {"robot": "panda", "mixing": label, "direct term": "yes"})[
            "below 1 % of its bound after [s]"
        ]
        for name, label in (
            ("unmixed", "Unmixed, all parameters"),
            ("paper", "Determinant, all parameters (the paper)"),
            ("default", "Unmixed, with joint terms (default)"),
        )
    }
    yield f"after {took['unmixed']} s unmixed and {took['paper']} s by the paper's determinant"
    yield f"takes {took['default']} s"


CLAIMS = [
    ("README.md", arrivals), ("README.md", references), ("README.md", load), ("README.md", logs),
    ("README.md", cost),
    ("docs/index.md", arrivals), ("docs/index.md", residues), ("docs/index.md", beside_others),
    ("docs/benchmarks/index.md", costs),
    ("docs/how-to/loads-and-friction.md", loads),
    ("docs/how-to/noise-and-delay.md", hardware), ("docs/how-to/noise-and-delay.md", mixing),
]  # fmt: skip


@pytest.mark.parametrize(("page", "claim"), CLAIMS, ids=lambda value: getattr(value, "__name__", value))
def test_the_page_says_what_the_table_says(page, claim):
    """Every figure is found in the text as the table has it, rounded as the text rounds."""
    text = " ".join((ROOT / page).read_text("utf-8").split())
    for figure in claim():
        assert figure in text, f"{page} does not say: {figure}"
