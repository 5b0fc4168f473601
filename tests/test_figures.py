"""The figures of README and site are those of the tables that benchmarks write."""

import re
from collections.abc import Iterator
from decimal import ROUND_HALF_UP, Decimal
from pathlib import Path

import pytest

from eladapt.worlds.rows import ROW

ROOT = Path(__file__).parents[1]
RIG = "rotors [kg m^2] / Coulomb [N m] / load [kg]"
Row = dict[str, str]


def result(name: str) -> str:
    """benchmarks/results/NAME.md"""
    return (ROOT / "benchmarks" / "results" / f"{name}.md").read_text("utf-8")


def table(name: str, number: int = 0) -> list[Row]:
    """One of the tables of a result: a dictionary a row, by the names of the columns."""
    lines = [part for part in result(name).split("\n\n") if part.startswith("|")][number].splitlines()
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


def first_seconds() -> Iterator[str]:
    rows = [row for row in table("real_arm") if row["controller"] == "composite"]
    off = {
        (arm, noise): max(
            float(row["sines: first second [rad]"])
            for row in rows
            if (row["arm"], row["noise, delay"]) == (arm, noise)
        )
        for arm in ("ur5e", "panda")
        for noise in ("no", "yes")
    }
    still, noisy, panda = off["ur5e", "no"], off["ur5e", "yes"], max(off["panda", "no"], off["panda", "yes"])
    yield f"up to {still:g} rad off its sines, with noise {noisy:g}; the Panda {panda:g}"


def identities() -> Iterator[str]:
    exact = ("W θ = τ", "ω θ = E", "p θ = M v", "Ψ θ_U = g", "W_r θ")
    largest = max((row[column] for row in table("identities") for column in exact), key=float)
    yield f"at most {short(largest)} relative"


def franka() -> Iterator[str]:
    rows = [row for row in table("franka_client") if row["told"] == "nothing"]
    empty, loaded = ([row for row in rows if row["load [kg]"] == load] for load in ("0", "1.5"))
    went = [sum(row["ended"] == "duration" for row in kind) for kind in (empty, loaded)]
    yield f"{went[0]} minutes of {len(empty)} go through without a load"
    yield f"{went[1]} of {len(loaded)} with 1.5 kg"
    after, rest = (
        short(max((row[what] for row in rows), key=float))
        for what in ("error 0.5 s after motions [rad]", "at rest [rad]")
    )
    yield f"within {after} rad half a second after each motion and {rest} rad at rest"


def franka_controllers() -> Iterator[str]:
    row = pick("franka_controllers", {"load [kg]": "1.5", "controller": "eladapt"})
    impedance = pick("franka_controllers", {"load [kg]": "1.5", "controller": "joint impedance"})
    weighed = re.search(r"it is weighed ([\d.]+) \+-", result("franka_controllers"))
    left, other = (short(one["at rest [rad]"]) for one in (row, impedance))
    yield f"leave {left} rad at rest with the load, where the maker's kind of joint impedance leaves {other}"
    yield f"weighed {float(weighed[1]):.2f} kg"


def stand_in() -> Iterator[str]:
    column = "error 0.5 s after motions [rad]"
    rows = [row for row in table("ur_stand_in") if row["what rubs"] == "friction"]
    plain = [float(row[column]) for row in rows if row["rotors told [kg m^2]"] == "0.0"]
    told = [row[column] for row in rows if row["rotors told [kg m^2]"] != "0.0"]
    yield f"within 1e-3 rad in {sum(error <= 1e-3 for error in plain)} runs of {len(plain)}"
    yield f"at most {short(str(max(plain)))} rad off"
    yield f"with rotors told by half within {short(max(told, key=float))} rad"


def latency() -> Iterator[str]:
    slowest = max(float(row["measurement to command [us]"].split(", ")[1]) for row in table("udp_loop"))
    yield f"99 % of the torques are out {slowest / 1e3:.2f} ms after"


def steps() -> Iterator[str]:
    one, two = (
        float(pick("step_cost", {"robot": robot})["whole step [us]"]) / 1e3
        for robot in ("panda", "talos, both arms")
    )
    yield f"{one:.2f} ms on a Panda and {two:.2f} ms on two arms of 14 joints"


def step_of_a_panda() -> Iterator[str]:
    took = float(pick("step_cost", {"robot": "panda"})["whole step [us]"]) / 1e3
    yield f"a step of a Panda with the whole θ takes {took:.2f} ms"


def rest() -> Iterator[str]:
    rows = table("rest")
    off = {row["what"]: [] for row in rows}
    for row in rows:
        off[row["what"]].append(row["gravity error of its largest"])
    moved = sorted(100 * float(number) for number in off["the same move, after sway"])
    yield f"joint swaying costs {100 * max(map(float, off['sway'])):.0f} %"
    yield f"shows {moved[0]:.0f} to {moved[1]:.0f} %"
    assert max(map(float, off["rest"] + off["the same move, after rest"])) <= 2e-4
    yield "right within 0.02 % of its largest torque"
    loads = [float(row["load of 1 kg"].split()[0]) for row in rows if row["load of 1 kg"] != "-"]
    yield f"weighed within {100 * max(abs(load - 1) for load in loads):.1f} %"


def physical() -> Iterator[str]:
    row = pick("physical_online", {"arm": "panda", "noise": "1e-4 rad, 1e-3 rad/s", "from": "urdf"})
    without, within = row["gravity elsewhere [N m]"].split(" / ")
    yield f"{float(within):.1f} instead of {float(without):.0f} N m"


def tool() -> Iterator[str]:
    rows = table("reach")
    still = max((row["no friction [mm]"] for row in rows), key=float)
    rough = max((row["friction, noise, delay [mm]"] for row in rows), key=float)
    yield f"rests within {short(still)} mm of it, and within {float(rough):.2f} mm with friction, noise"


def faults() -> Iterator[str]:
    yield f"{sum(row['fault'] != 'none' for row in table('faults'))} faults"


def worlds() -> Iterator[str]:
    said = result("stress")
    number, took = re.search(r"(\d+) worlds of panda by dask\.distributed: ([\d.]+) s on one", said).groups()
    each, tasks = float(took) / int(number), int(re.search(r"without work: (\d+) a second", said)[1])
    rate = 1000 / each  # of a thousand cores
    yield f"{each:.1f} s of a core"
    yield f"{1e7 * each / 3600 / 1e4:.1f} · 10⁴ core-hours, {1e7 * each / 3600 / 1000:.0f} h"
    yield f"{round(rate, -1):.0f} worlds a second"
    yield f"{ROW.itemsize} bytes | {round(rate * ROW.itemsize / 1e3, -1):.0f} kB/s"
    yield f"{1e7 * ROW.itemsize / 1e9:.1f} GB in the end"
    yield f"tasks without work | {tasks} a second"
    assert round(4 * rate / tasks) == 3
    yield f"three quarters of it with `--batch 1`, {100 * rate / 20 / tasks:.0f} % with 20"
    rows = table("stress", 1)
    memory = {row["worlds"]: row["most memory [MB]"] for row in rows}
    assert memory["100"] == memory["1,000"]
    yield f"{memory['100']} MB at 100 and 1,000 worlds, {memory['10,000']} MB at 10,000"
    slowest, fastest = (int(row["worlds a second"].replace(",", "")) // 1000 for row in (rows[0], rows[-1]))
    yield f"{slowest},000 to {fastest},000 worlds a second | {100 * rate / (1000 * slowest):.0f} % of it"


CLAIMS = [
    ("README.md", arrivals), ("README.md", references), ("README.md", load), ("README.md", logs),
    ("README.md", cost),
    ("docs/index.md", arrivals), ("docs/index.md", residues), ("docs/index.md", beside_others),
    ("docs/benchmarks/index.md", costs),
    ("docs/index.md", first_seconds), ("docs/limits.md", first_seconds), ("docs/limits.md", steps),
    ("CHANGELOG.md", step_of_a_panda),
    ("docs/hardware.md", franka), ("docs/hardware.md", franka_controllers), ("docs/hardware.md", stand_in),
    ("docs/hardware.md", latency), ("docs/stress.md", worlds),
    ("docs/how-to/regressors.md", identities), ("docs/how-to/motions.md", tool),
    ("docs/how-to/faults.md", faults), ("docs/benchmarks/index.md", faults),
    ("docs/how-to/loads-and-friction.md", loads), ("docs/how-to/loads-and-friction.md", rest),
    ("docs/how-to/loads-and-friction.md", physical),
    ("docs/how-to/noise-and-delay.md", hardware), ("docs/how-to/noise-and-delay.md", mixing),
]  # fmt: skip


@pytest.mark.parametrize(("page", "claim"), CLAIMS, ids=lambda value: getattr(value, "__name__", value))
def test_the_page_says_what_the_table_says(page, claim):
    """Every figure is found in the text as the table has it, rounded as the text rounds."""
    text = " ".join((ROOT / page).read_text("utf-8").split())
    for figure in claim():
        assert figure in text, f"{page} does not say: {figure}"
