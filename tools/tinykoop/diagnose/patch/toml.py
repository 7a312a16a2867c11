"""The TOML file of one's own robot: effects that act are told there, and belong to the simulator from then on."""

from ...plumbing.errors import UserError


def _value(number):
    return repr(float(number))


def patched(text, report, path):
    for effect in report["effects"]:
        if effect["segments"] and not _all_along(effect, report):
            raise UserError(f"{path}: {effect['name']} acts in a part of the log only; a simulator's number cannot say that")
    blocks = []
    for effect in report["effects"]:
        sizes = ", ".join(f"{name} = {_value(value)}" for name, value in effect["params"].items())
        blocks.append(f'\n[[effect]]  # {effect["formula"]}; found by tinykoop diagnose\nname = "{effect["name"]}"\nparams = {{{sizes}}}\n')
    return text.rstrip("\n") + "\n" + "".join(blocks)


def _all_along(effect, report):
    log, ((start, end), *more) = report["log"], effect["segments"]
    return not more and end - start >= 0.999 * log["seconds"]
