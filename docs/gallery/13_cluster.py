"""
How do I run a study on several machines?
=========================================

A study is cut into shards, and a shard can run anywhere.  With dask, workers on any number of machines take
them.  Here the whole cluster is on this one; the lines are the same otherwise.
"""

import subprocess
import sys
from pathlib import Path

import matplotlib.pyplot as plt

import fastcoil as fc

Path("cluster.toml").write_text("""
[loop]
preset = "lbnl"

[sweep]
backlash = { linspace = [0.0, 0.15, 8] }
estimate_ratio = [0.0, 0.6, 0.95]

[boundary]
hours = 2
seed = [1, 2]
""")

# %%
# In a terminal this is ``fastcoil run cluster.toml -o results/far --backend dask -j 1``.  Without an address it
# starts a cluster of its own, which ends with the study.  In the field a scheduler runs already: add its
# address, as in ``--scheduler tcp://10.0.0.5:8786``.

command = ["run", "cluster.toml", "-o", "results/far", "--backend", "dask", "-j", "1"]
done = subprocess.run([sys.executable, "-m", "fastcoil", *command], capture_output=True, text=True, check=True)
print(done.stdout)

plt.figure(figsize=(10, 6), layout="constrained")
plt.axis("off")
plt.imshow(plt.imread("results/far/figures/maps.png"))

# %%
# The same study on threads of this machine:

near = fc.run_study("cluster.toml", out="results/near", n_jobs=1)
far = fc.open_study("results/far")

# %%
# The answer:

same = far.attrs["content_sha256"] == near.attrs["content_sha256"]
print(f"{near.rmse.size} scenarios, on a cluster and without: {'the same bits' if same else 'different results'}.")
