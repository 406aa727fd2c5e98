"""
How do I run a study on several machines?
=========================================

A study is cut into shards, and a shard can run anywhere.  With dask, workers on any number of machines take
them.  Here the whole cluster is on this machine; the lines are the same otherwise.
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
# A scheduler and a worker, as ``dask scheduler`` and ``dask worker ADDRESS`` start them on any machine:

address = "tcp://127.0.0.1:8786"
quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
scheduler = subprocess.Popen(
    [sys.executable, "-m", "dask", "scheduler", "--host", "127.0.0.1", "--port", "8786", "--no-dashboard"], **quiet
)
worker = subprocess.Popen(
    [sys.executable, "-m", "dask", "worker", address, "--nthreads", "1", "--no-nanny", "--no-dashboard"], **quiet
)

# %%
# In a terminal this is ``fastcoil run cluster.toml -o results/far --backend dask --scheduler ADDRESS``:

command = ["run", "cluster.toml", "-o", "results/far", "--backend", "dask", "--scheduler", address]
done = subprocess.run([sys.executable, "-m", "fastcoil", *command], capture_output=True, text=True, check=True)
print(done.stdout)
for program in (worker, scheduler):
    program.terminate()
    program.wait()

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
