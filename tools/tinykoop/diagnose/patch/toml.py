"""The TOML file of your own robot: effects that act are added there, and belong to the simulator from then on."""


def _value(number):
    return repr(float(number))


def patched(text, report, path):
    blocks = []
    for effect in report["effects"]:
        sizes = ", ".join(f"{name} = {_value(value)}" for name, value in effect["params"].items())
        blocks.append(f'\n[[effect]]  # {effect["formula"]}; found by tinykoop diagnose\nname = "{effect["name"]}"\nparams = {{{sizes}}}\n')
    return text.rstrip("\n") + "\n" + "".join(blocks)
