"""
How do I run the controller in a co-simulation?
===============================================

fastcoil writes the controller as an FMU, which tools for co-simulation load.  Here FMPy drives it against a plant
that shares nothing with fastcoil's model, called as a test case of BOPTEST is.
"""

import matplotlib.pyplot as plt
import numpy as np
from fmpy import extract, read_model_description
from fmpy.fmi2 import FMU2Slave

import fastcoil as fc

# %%
# The same brisk PI twice, without and with an inverse of the gap:

loop = fc.Loop(kp=0.04, ti=20, sample_time=15)
for name, estimate in (("plain", 0.0), ("inverse", 0.066)):
    files = fc.export_controller(loop.assign(backlash_estimate=estimate), f"{name}.fmu", language="fmu")
    print(*(file.name for file in files))

# %%
# The plant is a coil of two lags behind a valve with a gap of 7 %.  It stands in for a building emulator:
# ``advance`` takes values of control points and returns measurements in SI units, as the request ``/advance`` of
# BOPTEST does.


class StandIn:
    step = 1.0  # s

    def initialize(self, start_time, warmup_period):
        self.time, self.motor, self.stem, self.coil, self.T_sup = start_time, 0.5, 0.47, 13.0, 13.0
        return self.advance({})

    def advance(self, u):
        if u.get("oveAhu_yCoo_activate"):
            self.motor += np.clip(u["oveAhu_yCoo_u"] - self.motor, -self.step / 90, self.step / 90)
        self.stem = np.clip(self.stem, self.motor - 0.07, self.motor)  # it moves once the gap is crossed
        self.coil += self.step / 60 * (26.0 - 26.0 * self.stem - self.coil)
        self.T_sup += self.step / 20 * (self.coil - self.T_sup)
        self.time += self.step
        return {"time": self.time, "reaAhu_TSup_y": self.T_sup + 273.15}


# %%
# With a deployed test case, requests take its place; this part is not run here::
#
#     url, put, post = "http://127.0.0.1:5000", requests.put, requests.post
#     put(f"{url}/step", json={"step": 15})
#     y = put(f"{url}/initialize", json={"start_time": 0, "warmup_period": 0}).json()["payload"]
#     y = post(f"{url}/advance", json={"oveAhu_yCoo_u": 0.5, "oveAhu_yCoo_activate": 1}).json()["payload"]
#
# FMPy calls the FMU, in steps of 1 s.  The controller acts every 15 s, its sample time, whatever the step is:


class Controller:
    def __init__(self, path):
        description = read_model_description(path)
        self.number = {variable.name: variable.valueReference for variable in description.modelVariables}
        self.fmu = FMU2Slave(
            guid=description.guid,
            modelIdentifier=description.coSimulation.modelIdentifier,
            unzipDirectory=extract(path),
        )
        self.fmu.instantiate()
        self.fmu.setupExperiment(startTime=0.0)
        self.fmu.enterInitializationMode()
        self.fmu.setReal([self.number["start_command"]], [0.5])  # takes over without a bump
        self.fmu.exitInitializationMode()

    def command(self, time, T_sup, T_set):
        self.fmu.setReal([self.number["T_sup"], self.number["T_set"]], [T_sup, T_set])
        self.fmu.doStep(time, StandIn.step)
        return self.fmu.getReal([self.number["command"]])[0]


def run(path, hours=2):
    controller, case, T_sup, command = Controller(path), StandIn(), [], []
    y = case.initialize(start_time=0, warmup_period=0)
    for second in range(hours * 3600):
        T_sup.append(y["reaAhu_TSup_y"] - 273.15)
        command.append(controller.command(second, T_sup[-1], 14.0 if second < 3600 else 15.0))
        y = case.advance({"oveAhu_yCoo_u": command[-1], "oveAhu_yCoo_activate": 1})
    controller.fmu.terminate()
    controller.fmu.freeInstance()
    return np.array(T_sup), np.array(command)


runs = {name: run(f"{name}.fmu") for name in ("plain", "inverse")}

# %%
# Supply air and command:

figure, panels = plt.subplots(2, 1, sharex=True, figsize=(8, 4.4), layout="constrained")
for (name, series), color in zip(runs.items(), ("#BB5566", "#004488"), strict=True):
    for panel, values in zip(panels, series, strict=True):
        panel.plot(np.arange(values.size) / 3600, values, color=color, label=name)
panels[0].set(ylabel="supply air [°C]")
panels[1].set(ylabel="command", xlabel="time [h]")
panels[0].legend()

# %%
# The answer:

rms = {name: np.std(T_sup[1800:3600]) for name, (T_sup, _) in runs.items()}
print(
    f"The supply air swings by {rms['plain']:.2f} K rms with the plain PI, by {rms['inverse']:.2f} K with the inverse."
)
