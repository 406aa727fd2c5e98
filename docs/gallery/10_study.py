"""
How do I repeat, check and extend a study?
==========================================

Put work that you want to keep in a study file.  Anyone can run it again, check it years later, and extend
it without computing anything twice.
"""

import subprocess
import sys
from pathlib import Path

import matplotlib.pyplot as plt

import fastcoil as fc

# %%
# The file says which loops on which days:

study = Path("gaps.toml")
study.write_text("""
[loop]
preset = "lbnl"

[sweep]
backlash = [0.02, 0.07]
estimate_ratio = [0.0, 0.95]

[boundary]
hours = 2
seed = [1, 2]
""")


def fastcoil(*words):
    """What you would type in a terminal: fastcoil WORDS."""
    done = subprocess.run([sys.executable, "-m", "fastcoil", *words], capture_output=True, text=True, check=False)
    print(done.stdout + done.stderr)


# %%
# ``run`` runs it and draws figures; ``plan`` would say beforehand how large it is and how long it takes:

fastcoil("run", "gaps.toml", "-j", "1")

plt.figure(figsize=(10, 6), layout="constrained")
plt.axis("off")
plt.imshow(plt.imread("results/gaps/figures/bands.png"))

# %%
# ``verify`` checks every file of the folder against its hash.  ``rerun`` simulates one scenario again, with
# every signal:

fastcoil("verify", "results/gaps")
fastcoil("rerun", "results/gaps", "--at", "backlash=0.07,estimate_ratio=0.95,day=1")

# %%
# One more gap.  Only the new scenarios are simulated:

before = fc.open_study("results/gaps")
study.write_text(study.read_text().replace("[0.02, 0.07]", "[0.02, 0.07, 0.12]"))
fastcoil("run", "gaps.toml", "--extend", "-j", "1")

# %%
# A mistake is reported before anything runs:

Path("wrong.toml").write_text(study.read_text().replace("lbnl", "lnbl").replace("hours = 2", "hours = -2"))
fastcoil("plan", "wrong.toml")

# %%
# The answer:

after = fc.open_study("results/gaps")
same = bool((after.rmse.sel(backlash=before.backlash) == before.rmse).all())
print(
    f"{before.rmse.size} scenarios became {after.rmse.size}; the first ones kept every bit: {'yes' if same else 'no'}."
)
