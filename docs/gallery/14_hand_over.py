"""
How do I take the controller home?
==================================

A controller that was chosen here has to run in the field, on a PLC or in a building controller.  fastcoil
writes it as C, Structured Text or Python, with test vectors to verify any port of it.
"""

import subprocess
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import pandas as pd

import fastcoil as fc

# %%
# One loop, with the estimator ``identify`` and a buffer against noise:

loop = fc.Loop.preset("lbnl").assign(backlash=0.07, estimator="identify", buffer=0.002)
for language, name in (("c", "ahu1.c"), ("st", "ahu1.st"), ("python", "ahu1.py")):
    files = fc.export_controller(loop, name, language=language)
    print(language, *(file.name for file in files))

# %%
# Each is one file that can be read.  The head of the Structured Text:

print("\n".join(Path("ahu1.st").read_text().splitlines()[:24]))

# %%
# The vectors contain the required outputs, cycle by cycle.  The exported Python checks itself against
# them, as the exported C does with a compiler:

done = subprocess.run([sys.executable, "ahu1.py", "ahu1_vectors.csv"], capture_output=True, text=True, check=False)
print(done.stdout)

# %%
# A port of yours passes when its columns equal these.  The last of the runs is this loop on a simulated day:

vectors = pd.read_csv("ahu1_vectors.csv", comment="#")
day = vectors[vectors.reset.cumsum() == vectors.reset.sum()]
hours = (day.index - day.index[0]) * float(loop["sample_time"]) / 3600
figure, panels = plt.subplots(2, 1, sharex=True, figsize=(8, 4.4), layout="constrained")
panels[0].plot(hours, day.T_sup, color="#004488", label="given: supply air")
panels[0].plot(hours, day.T_set, color="#DDAA33", linestyle="--", label="given: set-point")
panels[1].plot(hours, day.command, color="#004488", label="expected: command")
panels[1].plot(hours, day.estimate, color="#BB5566", linestyle="--", label="expected: estimate")
panels[0].set(ylabel="temperature [°C]")
panels[1].set(ylabel="fraction of stroke", xlabel="time [h]")
for panel in panels:
    panel.legend()

# %%
# The answer:

lines = len(Path("ahu1.c").read_text().splitlines())
passed = "equals" if done.returncode == 0 else "does not equal"
print(f"{lines} lines of C; over {len(vectors)} cycles the exported Python {passed} the controller that was simulated.")
