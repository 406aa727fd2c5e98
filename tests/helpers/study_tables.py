"""Studies as tables, of which one may be a larger version of another."""

import json

from fastcoil.study.run import execute
from helpers.studies import run_until_stopped


def toml(tables):
    """The text of a study file."""

    def shown(value):
        if isinstance(value, dict):
            return "{ " + ", ".join(f"{k} = {shown(v)}" for k, v in value.items()) + " }"
        return json.dumps(value)

    lines = []
    for name, table in tables.items():
        nested = name == "cases"
        for part, values in table.items() if nested else [(None, table)]:
            lines.append(f"[{name}.{part}]" if part else f"[{name}]")
            lines += [f"{k} = {shown(v)}" for k, v in values.items()]
    return "\n".join(lines) + "\n"


def run_shards(study, folder, n_shards):
    """Run a study until some shards are done, or else to its end.  Returns how many scenarios were run."""
    if n_shards:
        return run_until_stopped(study, folder, n_shards)
    return execute(study, folder).n_run


_fresh = {}


def fresh(study, folder):
    """The hash of a study that is run at once, in a folder of its own; the same study is run only once."""
    key = study.title, study.text, study.sha256
    if key not in _fresh:
        _fresh[key] = execute(study, folder / "fresh").results.attrs["content_sha256"]
    return _fresh[key]
