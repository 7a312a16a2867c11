"""The command `tinykoop`."""

import argparse
import os
import signal
import sys
from importlib.metadata import version
from pathlib import Path

from .formats import FORMATS
from .platforms import COLUMNS as PLATFORMS
from .plumbing import checkout
from .plumbing.errors import UserError
from .plumbing.results import printable

INTO = ".toml of your own robot, .yaml of a diff_drive_controller, .xml of MuJoCo, .urdf, .xacro, .sdf, .py or .c"
OWN, OWN_FILE = "FILE:NAME", "own.py:NAME or own.c:NAME"
VEHICLES = "of a quadrotor: crazyflie (default), iris, racing, or your own TOML file (docs/quadrotor.md)"
TABLES = (  # commands that write what they measured into the docs
    "learn", "control", "ledger", "transfer", "windup", "study", "supervisor", "real", "flights", "bench", "blind", "fleet", "constants", "coverage", "mutants", "fuzz", "static", "soak",
    "flips", "determinism", "sanitize", "settings",
)  # fmt: skip
DEVELOPERS = (  # commands that work on the files of a checkout
    "targets", "settings", "bench", "coverage", "mutants", "fuzz", "static", "soak", "flips", "determinism", "flags", "sanitize",
)  # fmt: skip
OUT_NAME = "build/out" if checkout.EXISTS else checkout.OUT

# What a shell says of a program that SIGPIPE ends, as `| head` ends those in C. Python ignores the signal: it would end
# the process in the middle of a write, or where a worker's pipe is gone.
CLOSED = 128 + getattr(signal, "SIGPIPE", 13)  # which Windows has not

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # matrices are small here: threads cost more than they bring


def _your_log(add):
    gap = add("diagnose", "where a simulator and a log differ, which effect is missing, how far the gap closes")
    gap.add_argument("log", nargs="+", help="several logs, or a folder with logs: one report each, and one table")
    gap.add_argument("--fresh", help="another log of the same robot, to validate the result without refitting")
    whose = f"{', '.join(PLATFORMS)}, quadrotor:VEHICLE, or the TOML file of your own (docs/own-robot.md)"
    gap.add_argument("--robot", "--platform", metavar="ROBOT", help=f"{whose}; default: the platform that the columns tell")
    gap.add_argument("--healthy", nargs="+", default=[], metavar="LOG", help="logs of the healthy or earlier robot: then, what changed")
    gap.add_argument("--sim", metavar="SIM.csv", help="TOML file: a run of your simulator under the log's commands, instead of [simulator]")
    gap.add_argument("--without", action="append", default=[], metavar="EFFECT", help="an effect this robot cannot have")
    limit = "exit status 1 if the simulator's error at the longest horizon is larger (m, rad, ..), in any of the logs"
    gap.add_argument("--max-gap", type=float, metavar="SIZE", help=limit)
    gap.add_argument("--mcap", metavar="OUT.mcap", help="also write measured and predicted paths, residuals and events, for Foxglove")
    gap.add_argument(
        "--pool", action="store_true", help="for several logs of one robot: also fit them together, with sizes common or per group"
    )
    gap.add_argument(
        "--groups", nargs="+", metavar="LABEL", help="with --pool: the ground, tyres or battery of each log (default: each log its own)"
    )
    gap.add_argument("--jobs", type=int, help="for several logs: processes (default: all cores)")
    gap.add_argument("--cluster", help="for several logs: address of a Dask scheduler that shares these folders")
    robot = add("robot", "your own robot: write its file, check it against a log (docs/own-robot.md)", out=False)
    what = robot.add_subparsers(dest="what", required=True, metavar="WHAT")
    what.add_parser("new", help="write NAME.toml and NAME.py to begin with").add_argument("name", metavar="NAME")
    check = what.add_parser("check", help="units, signs, wrapping and timing of a log, as the robot's file has them")
    check.add_argument("robot", metavar="ROBOT.toml")
    check.add_argument("log")
    check.add_argument("--sim", metavar="SIM.csv", help="a run of your simulator under the log's commands, instead of [simulator]")
    fix = add("patch", "put the effects of a report into the file of a robot, simulator or controller", out=False)
    fix.add_argument("report", metavar="report.json")
    fix.add_argument("--into", required=True, metavar="FILE", help=INTO)
    fix.add_argument("--write", action="store_true", help="change the file; otherwise the change is printed as a diff")
    effects = add("effects", "list all effects with formula, parameters, units, bounds and typical size", out=False)
    effects.add_argument("--robot", default="ddr", metavar="ROBOT", help=whose)
    effects.add_argument("--log", help="sizes as they are in this log of your own robot")
    play = add("replay", "run every method over a log, both precisions and forms")
    play.add_argument("log")
    play.add_argument("--platform", choices=PLATFORMS, help="default: by the columns")
    play.add_argument("--dictionary", metavar=OWN, help=f"your own, with every regulator, instead of poly and rbf: {OWN_FILE}")

    pick = add("choose", "choose dictionary, regulator, lambda and dead zone by prediction errors")
    pick.add_argument("log", nargs="+")
    pick.add_argument("--platform", choices=PLATFORMS, help="default: by the columns")
    pick.add_argument("--dictionary", metavar=OWN, help=f"your own, beside poly, rbf and affine: {OWN_FILE}")
    pick.add_argument(
        "--closed-loop", nargs="*", metavar="NAME[=V,V]",
        help="ddr: also track a path in the simulator, with these effects of your robot (tinykoop effects)",
    )  # fmt: skip

    when = add("changes", "detect when something changed in a log, such as wind, from its innovations")
    when.add_argument("log")
    when.add_argument("--platform", choices=PLATFORMS, help="default: by the columns")

    convert = add("convert", "convert a log of an autopilot or ROS 2, or a CSV of your own (docs/convert.md)", out=False)
    convert.add_argument("source", help="log file, or folder of a bag or of a cfclient session")
    convert.add_argument("csv", metavar="OUT.csv", help="file to write")
    convert.add_argument("--platform", choices=PLATFORMS, required=True, help="which columns")
    known = "; ".join(f"{name} ({what})" for name, what in FORMATS.items())
    convert.add_argument("--format", choices=FORMATS, help=f"default: by what is in the file. {known}")
    convert.add_argument("--rate", type=float, metavar="HZ", help="rows per second (default: the rate of the slowest part of the state)")
    convert.add_argument(
        "--map", nargs="+", action="extend", default=[], metavar="MAP",
        help="sources of columns, such as u=ctrltarget.pitch px=x[mm], or a TOML file with [log] (docs/convert.md)",
    )  # fmt: skip
    convert.add_argument("--damaged", action="store_true", help="read what is intact of a truncated file")

    flight = add("fly", "simulate a flight of the flapping-wing vehicle or a quadrotor and write its log", out=False)
    flight.add_argument("manoeuvre", help="fwmav: hover, pitch, yaw; quadrotor: hover, legs, mixed")
    flight.add_argument("--platform", choices=("fwmav", "quadrotor"), default="fwmav", help="what flies (default: fwmav)")
    flight.add_argument("--vehicle", metavar="VEHICLE", help=VEHICLES)
    flight.add_argument("log", type=Path, help="file to write, .csv")
    flight.add_argument("--seconds", type=float, default=40.0, help="of the flight")
    flight.add_argument("--seed", type=int, default=1, help="of noise and turbulence")
    flight.add_argument(
        "--effect", action="append", default=[], metavar="NAME[=V,V][@T0,T1]",
        help="an unmodelled effect, with its usual parameters or these, all the time or from T0 to T1 (s)",
    )  # fmt: skip

    fit = add("fit", "fit an offline model to a log, as a C header or binary for firmware", out=False)
    fit.add_argument("log")
    fit.add_argument("model", help="file to write, .h or .bin")
    fit.add_argument("--platform", choices=PLATFORMS, help="default: by the columns")
    fit.add_argument("--dictionary", default="rbf", metavar=OWN, help=f"poly, rbf, affine, or your own: {OWN_FILE}")
    fit.add_argument("--precision", type=int, choices=(32, 64), default=32, help="bits of a number")
    fit.add_argument("--p0", type=float, default=1e4, help="one over the ridge regularisation")


def _paper(add):
    demo = add("demo", "learning, control, ablations, precision study and one gap diagnosis: about a minute")
    demo.add_argument("--log", help="replay this log as well")
    demo.add_argument("--update", action="store_true", help="also update the pictures of the README")
    learn = add("learn", "one-step learning of the DDR, the paper's table")
    add("control", "Koopman-MPC tracking of the DDR, the paper's table")
    add("ledger", "the paper's claims, each with our figure and a verdict")
    transfer = add("transfer", "a model of other flights goes on learning, the paper's table")
    transfer.add_argument(
        "--platform", choices=("fwmav", "quadrotor"), default="fwmav", help="fwmav: across flight regimes; quadrotor: healthy and changed"
    )
    own = "folder of real flights beside the simulated ones; fwmav: pitch*.csv and yaw*.csv; quadrotor: with labels.csv"
    transfer.add_argument("--data", type=Path, help=own)
    real = add("real", "real logs replayed and, of drives, diagnosed: the figures of the docs on real robots")
    real.add_argument("--data", type=Path, nargs="+", required=True, help="logs, or folders of logs")
    flights = add("flights", "real quadrotor flights with known causes: what is said of each, beside peers")
    flights.add_argument("--data", type=Path, required=True, help="folder with labels.csv and the flights (docs/quadrotor-flights.md)")
    ablate = add("ablate", "dead-zone threshold, constant-trace settings, rollouts")
    windup = add("windup", "float32 against float64 for every dictionary, regulator and form")
    for command in (learn, ablate, windup):
        command.add_argument("--dictionary", metavar=OWN, help=f"your own, beside poly and rbf: {OWN_FILE}")
    study = add("study", "which Poly runs fail under control and why, and the sensitivities that control sees")
    study.add_argument("--runs", type=int, default=10, help="runs of each setting; ten take about four minutes")
    add("supervisor", "random closed-loop runs with and without the supervisor")


def _firmware(add):
    dictionary = add("dictionary", "C code of a dictionary of your own that was put together in Python", out=False)
    what = dictionary.add_subparsers(dest="what", required=True, metavar="WHAT")
    export = what.add_parser("export", help="write the code of a dictionary of parts as a C header", formatter_class=_Help)
    export.add_argument("dictionary", metavar="FILE.py:NAME")
    export.add_argument("-o", "--header", required=True, metavar="FILE.h", help="file to write")
    size = export.add_mutually_exclusive_group(required=True)
    size.add_argument("--states", "-n", type=int, metavar="N", help="number of values of a state")
    size.add_argument("--platform", choices=PLATFORMS, help="whose states")
    export.add_argument("--precision", type=int, choices=(32, 64), default=32, help="bits of a number")
    size = add("size", "bytes and instructions of the library on a microcontroller, for your sizes", out=False)
    size.add_argument("--lifted", "-N", type=int, required=True, help="lifted states N")
    size.add_argument("--states", "-n", type=int, required=True, help="of which are the state itself")
    size.add_argument("--inputs", "-m", type=int, required=True, help="commands m")
    size.add_argument("--horizon", "-H", type=int, default=50, help="steps of the controller")
    size.add_argument("--precision", type=int, choices=(32, 64), default=32, help="bits of a number")
    size.add_argument("--target", default="cortex-m4f", help="a folder of targets/")

    cross = add("targets", "builds for microcontrollers, runs on QEMU: tests, closed loop, footprint")
    cross.add_argument("--update", action="store_true", help="take the figures over into targets/footprint.json and the docs")
    add("settings", "compiler settings by code size, instructions and estimated cycles on microcontrollers")
    bench = add("bench", "time the update, the solve and the learner in Python against peers, side by side")
    bench.add_argument("--quick", action="store_true", help="one round of each, which shows that it runs")


def _assurance(add):
    blind = add("blind", "blind evaluation of the diagnoser on simulated logs with sealed labels")
    blind.add_argument("--platform", choices=tuple(PLATFORMS), default="ddr", help="whose diagnoser")
    blind.add_argument("--robot", help="a robot of examples/own_robot instead, such as car")
    blind.add_argument("--inject", metavar="FLIGHT.csv", help="fwmav: inject known effects into this real flight instead")
    blind.add_argument(
        "--n", type=int, default=20, help="logs of each tier (quadrotor: of each effect); of a drive, one has at most 900 rows"
    )
    blind.add_argument("--tier", action="append", metavar="NAME", help="only this tier, may be given several times (default: all)")
    blind.add_argument("--seed", type=int, default=1, help="of all logs")
    blind.add_argument("--no-peers", action="store_true", help="drives: leave out the methods compared with, which take most of the time")
    blind.add_argument("--jobs", type=int, help="processes (default: all cores)")
    blind.add_argument("--cluster", help="address of a Dask scheduler")

    fleet = add("fleet", "processor time per diagnosis of many simulated drives, and what 10,000 per hour take")
    fleet.add_argument("--n", type=int, default=1000, help="drives")
    fleet.add_argument("--seed", type=int, default=2026, help="of all drives")
    fleet.add_argument("--jobs", type=int, help="processes (default: all cores)")
    fleet.add_argument("--cluster", help="address of a Dask scheduler that shares these folders")
    constants = add("constants", "constants of the diagnoser: which answers change when each is halved, doubled")
    constants.add_argument("--n", type=int, default=2, help="logs of each kind")
    constants.add_argument("--seed", type=int, default=7, help="of all logs")
    constants.add_argument("--jobs", type=int, help="processes (default: all cores)")
    constants.add_argument("--cluster", help="address of a Dask scheduler")

    add("coverage", "lines, branches and MC/DC of lib/ that the C tests reach")
    mutants = add("mutants", "how many small faults put into lib/ the C tests find")
    mutants.add_argument("--n", type=int, default=1000, help="mutants")
    mutants.add_argument("--seed", type=int, default=1, help="which mutants")
    mutants.add_argument("--file", help="all mutants of this file instead, such as lib/src/mpc.c")
    fuzz = add("fuzz", "libFuzzer on the CSV reader, every public call, and sequences of calls")
    fuzz.add_argument("--seconds", type=float, default=60.0, help="for each target")
    add("static", "clang-tidy, cppcheck with MISRA, gcc -fanalyzer, Frama-C, complexity of lib/")
    soak = add("soak", "every kind of estimator through every kind of fault")
    soak.add_argument("--updates", type=float, default=1e8, help="in all")
    flips = add("flips", "one flipped bit in the storage of learner, gate, supervisor and controller")
    flips.add_argument("--trials", type=float, default=240e3, help="in all")
    flips.add_argument("--seed", type=int, default=1, help="of the robots and of the bits")
    add("determinism", "the same bits from both compilers, all optimisation levels, and a Cortex-M4F")
    flags = add("flags", "the C tests with lib/ under the compiler flags of flight stacks")
    flags.add_argument("--compiler", action="append", help="only this one of gcc, clang, clang-19, arm-none-eabi-gcc; may be given again")
    flags.add_argument(
        "--set", action="append", metavar="NAME", help="only these flags of test/flags/stacks.json, as PX4; may be given again"
    )
    add("sanitize", "the tests under AddressSanitizer, UBSan, ThreadSanitizer and valgrind")


def _written(default):
    return f"{default:.15g}" if isinstance(default, float) else default


class _Help(argparse.HelpFormatter):
    """Shows the defaults as they are."""

    def _get_help_string(self, action):
        shown = action.default not in (None, False, [], argparse.SUPPRESS) and action.option_strings and "default" not in action.help
        return f"{action.help} (default: {_written(action.default)})" if shown else action.help


GROUPS = {"your log": _your_log, "the paper": _paper, "firmware": _firmware, "assurance": _assurance}


def parser():
    """Arguments of all subcommands. Modules are imported on use: matplotlib takes a second."""
    about = "Learn a robot's dynamics, and find what its simulator lacks."
    main = argparse.ArgumentParser(prog="tinykoop", description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    main.add_argument("--version", action="version", version=f"tinykoop {version('tinykoop')}")
    commands = main.add_subparsers(dest="command", required=True, metavar="COMMAND", help="one of these; COMMAND --help says more")
    listed = []

    def add(name, summary, out=True):
        listed.append(f"  {name:<13}{summary}")
        command = commands.add_parser(name, description=summary, formatter_class=_Help)
        if out:
            command.add_argument("--out", default=checkout.OUT, type=Path, help=f"folder for results (default: {OUT_NAME})")
        if name in TABLES:
            command.add_argument("--update", action="store_true", help="also write the figures into README and docs/")
        return command

    for group, fill in GROUPS.items():
        listed.append(f"\n{group}:")
        fill(add)
    main.epilog = "\n".join(listed)
    return main


def _needs_checkout(a):
    """Refuses, where there is no checkout, what works on its files."""
    if a.command in DEVELOPERS:
        checkout.need(a.command)
    for option in ("update", *(("robot",) if a.command == "blind" else ())):
        if getattr(a, option, None):
            checkout.need(f"{a.command} --{option}")


def _diagnosed(a):
    """The folder for reports of diagnoses."""
    return a.out / "diagnose" if a.out == checkout.OUT else a.out


def _several(a, diagnose):
    """Diagnoses several logs, or all of a folder; true where one has a larger gap than allowed."""
    from .diagnose import pooled, several

    logs = several.files(a.log)
    if a.pool:
        pooled.check(logs, a.groups, a.robot)
    if a.sim:
        raise UserError("--sim: a run under the commands of one log; give one log")
    if a.mcap:
        raise UserError("--mcap: the recording of one log; give one log")
    options = {"robot": a.robot, "fresh": a.fresh, "without": a.without, "healthy": a.healthy}
    reports = several.run(logs, _diagnosed(a), options, a.jobs, a.cluster)
    if a.pool:
        pooled.run(reports, _diagnosed(a), a.groups, a.robot, a.without, a.healthy)
    return sum(diagnose.exceeds(report, a.max_gap, log) for log, report in reports) > 0  # each says so


def dispatch(a):
    """Runs one subcommand; true where what was asked for does not hold."""
    _needs_checkout(a)
    if a.command == "demo":
        from . import demo

        demo.run(a.out, a.log, a.update)
    elif a.command == "fly":
        from .logs import fly

        fly.run(a.manoeuvre, a.seconds, a.seed, a.effect, a.log, a.platform, a.vehicle)
    elif a.command == "replay":
        from .logs import replay

        replay.run_log(a.log, a.out, a.platform, a.dictionary)
    elif a.command == "choose":
        from .logs import choose

        choose.run(a.log, a.out, a.platform, a.dictionary, a.closed_loop)
    elif a.command == "changes":
        from .logs import changes

        changes.run(a.log, a.out, a.platform)
    elif a.command == "fit":
        from .logs import fit

        fit.run(a.log, a.model, a.dictionary, a.precision, a.platform, a.p0)
    elif a.command == "convert":
        from . import convert

        convert.run(a.source, a.csv, a.platform, a.format, a.rate, a.map, a.damaged)
    elif a.command == "transfer":
        from .experiments import transfer, transfer_quadrotor

        {"fwmav": transfer, "quadrotor": transfer_quadrotor}[a.platform].run(a.out, a.data, a.update)
    elif a.command == "real":
        from .experiments import real

        real.run(a.out, a.data, a.update)
    elif a.command == "flights":
        from .experiments import flights

        flights.run(a.out, a.data, a.update)
    elif a.command == "study":
        from .experiments import study

        study.run(a.out, a.runs, a.update)
    elif a.command == "diagnose":
        from . import diagnose

        if a.groups and not a.pool:
            raise UserError("--groups: labels of logs that are fitted together; add --pool")
        if a.pool or len(a.log) > 1 or Path(a.log[0]).is_dir():
            return _several(a, diagnose)
        result = diagnose.run(a.log[0], _diagnosed(a), a.fresh, a.robot, a.without, a.healthy, a.sim, a.mcap)
        return diagnose.exceeds(result.report, a.max_gap)
    elif a.command == "robot":
        from .diagnose.robots import check, new

        check.run(a.robot, a.log, a.sim) if a.what == "check" else new.run(a.name)
    elif a.command == "patch":
        from .diagnose import patch

        patch.run(a.report, a.into, a.write)
    elif a.command == "effects":
        from .diagnose.robots import effects

        effects.run(a.robot, a.log)
    elif a.command == "fleet":
        from .blind import fleet

        fleet.run(a.out, a.n, a.seed, a.cluster, a.jobs, a.update)
    elif a.command == "constants":
        from .blind import constants

        constants.run(a.out, a.n, a.seed, a.cluster, a.jobs, a.update)
    elif a.command == "blind":
        from . import blind
        from .blind import flights, injected, own
        from .blind.own import campaign

        if a.tier and (a.robot or a.platform == "fwmav"):
            raise UserError("--tier: only for the drive and the quadrotor; leave out --robot and --platform, or leave out --tier")
        if a.robot:
            if a.robot not in own.ROBOTS:
                raise UserError(f"--robot {a.robot}: no plant of its own; there are {', '.join(own.ROBOTS)}")
            campaign.run(a.out, a.robot, a.n, a.seed, a.cluster, a.jobs, update=a.update)
            return None
        if a.inject:
            if a.platform != "fwmav":
                raise UserError("--inject: only for flights of the flapping wing; add --platform fwmav")
            if a.update:
                raise UserError("--update: no page has figures of --inject; leave it out")
            injected.run(a.out, a.inject, a.jobs)
            return None
        if a.platform == "fwmav":
            flights.run(a.out, a.n, a.seed, a.cluster, a.jobs, update=a.update)
            return None
        if a.platform == "quadrotor":
            from .blind.quadrotor import campaign as second_quadrotor

            second_quadrotor.run(a.out, a.n, a.seed, a.cluster, a.jobs, a.tier, update=a.update)
            return None
        blind.run(a.out, a.n, a.seed, a.cluster, a.jobs, a.tier, update=a.update, peers=not a.no_peers)
    elif a.command == "dictionary":
        from . import dictionaries, platforms

        n = platforms.learned(a.platform) if a.platform else a.states
        dictionaries.export(a.dictionary, a.header, n, a.precision)
    elif a.command == "size":
        from .firmware import size

        size.run(a.lifted, a.states, a.inputs, a.horizon, a.precision, a.target)
    elif a.command == "targets":
        from .firmware import targets

        targets.run(a.out, a.update)
    elif a.command == "bench":
        from . import bench

        bench.run(a.out, checkout.ROOT / "build/bench", a.update, a.quick)
    elif a.command == "fuzz":
        from .assure import fuzz

        fuzz.run(a.out, a.seconds, a.update)
    elif a.command == "flags":
        from .assure import flags

        flags.run(a.out, a.compiler, a.set)
    elif a.command == "mutants":
        from .assure import mutants

        mutants.run(a.out, a.n, a.seed, a.file, a.update)
    elif a.command == "soak":
        from .assure import soak

        soak.run(a.out, a.updates, update=a.update)
    elif a.command == "flips":
        from .assure import flips

        flips.run(a.out, a.trials, a.seed, update=a.update)
    else:
        from importlib import import_module

        room = (
            "firmware"
            if a.command == "settings"
            else "assure"
            if a.command in ("coverage", "static", "determinism", "sanitize")
            else "experiments"
        )
        options = {name: getattr(a, name) for name in ("update", "dictionary") if name in a}
        if all(options.values()) and len(options) == 2:
            raise UserError("--update: the pages have the figures of poly and rbf; leave out --dictionary")
        import_module(f"tinykoop.{room}.{a.command}").run(a.out, **options)


def _run():
    """Runs what the arguments say, and writes out what it has printed while its failure can still be told; the exit status."""
    try:
        return 1 if dispatch(parser().parse_args()) else 0
    finally:
        sys.stdout.flush()


def _refuse(line):
    print(f"tinykoop: {printable(line)}", file=sys.stderr)
    return 2


def _drop_output():
    """Python tries again at its end to print what could not be printed: into nothing then, without a word."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def main():
    """Exit status 2 and one line on standard error for what the user can mend; CLOSED without a word for a reader that is gone."""
    sys.stdout = sys.stdout or open(os.devnull, "w")  # none: `>&-`
    sys.stdout.reconfigure(errors="backslashreplace")  # names of files need not be UTF-8, nor the terminal
    try:
        return _run()
    except UserError as error:
        return _refuse(error)
    except ModuleNotFoundError as error:
        if error.name.startswith("tinykoop"):
            raise
        return _refuse(f"the Python package '{error.name}' is missing: {checkout.install('test')}")
    except KeyboardInterrupt:
        return 128 + signal.SIGINT
    except BrokenPipeError:
        _drop_output()
        return CLOSED
    except OSError as error:  # of the terminal or a temporary file: results say it themselves
        _drop_output()
        return _refuse(f"{error.strerror or error}{f': {error.filename}' if error.filename else ''}")


if __name__ == "__main__":
    sys.exit(main())
