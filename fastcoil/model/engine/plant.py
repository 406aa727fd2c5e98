"""What stands behind the valve of a block of lanes: a plant in place of the coil, and the room behind either.

A plant of the user is a stage, called in every second before the controller, with the valve as the second before left
it.
"""

from functools import cache
from typing import Any, NamedTuple

from fastcoil.model.engine.rows import LANES, T_A, T_C, VOLUME_STRIDE, W_A, R, begin_run
from fastcoil.model.engine.rules import compile_exact
from fastcoil.model.engine.valve import scale_water_flow, update_water_flow
from fastcoil.model.estimators.interface import StepRule, memory_defaults
from fastcoil.model.numerics.jit import kernel, section
from fastcoil.model.numerics.stages import FLAG, INTEGER, NUMBER, ROW_POINTER, StageSignature, store_if_due, values_at
from fastcoil.model.physics import next_room_temperature


class PlantInputs(NamedTuple):
    """What a plant sees in a second: the valve as it was ``dead_time`` seconds ago, and what enters now."""

    t: float  # time since the start, s
    m_w: float  # water flow, kg/s
    opening: float  # of the valve, 0–1
    m_a: float  # air flow, kg/s
    T_a_in: float  # entering air, °C
    W_a_in: float  # its humidity ratio, kg/kg
    T_w_in: float  # entering water, °C


PLANT_SIGNATURE = StageSignature(
    S=ROW_POINTER, V=ROW_POINTER, plant_state=ROW_POINTER, n_kept=INTEGER, t=INTEGER, m_a=NUMBER, T_a_in=NUMBER,
    W_a_in=NUMBER, T_w_in=NUMBER, is_start=FLAG,
)  # fmt: skip
"""Stages that stand in place of the coil, see ``plant_stage``."""
call_plant = PLANT_SIGNATURE.call


@cache
def plant_stage(plant: StepRule) -> Any:
    """Return the address of a plant compiled for a block, see PLANT_SIGNATURE.

    plant_state: its parameters, its memory, and, behind them, openings and water flows of the last ``n_kept`` seconds.
    What leaves stands in V where the air of volume 1 stands, and as its metal, whose range is watched.
    """
    step, Parameters, Memory, defaults = (
        compile_exact(plant.step), plant.Parameters, plant.Memory, memory_defaults(plant.Memory)
    )  # fmt: skip
    memory_at = len(Parameters._fields) * LANES
    kept_at = memory_at + len(Memory._fields) * LANES

    def march(S, V, plant_state, n_kept, t, m_a, T_a_in, W_a_in, T_w_in, is_start):
        if is_start:
            for j in range(LANES):
                memory = values_at(Memory, plant_state, memory_at + j, LANES)
                store_if_due(True, Memory(*defaults), memory, plant_state, memory_at + j, LANES)
                for k in range(n_kept):
                    plant_state[kept_at + k * LANES + j] = S[R.opening + j]
                    plant_state[kept_at + (n_kept + k) * LANES + j] = S[R.m_w + j]
            return
        slot = kept_at + t % n_kept * LANES
        for j in range(LANES):
            plant_state[slot + j] = S[R.opening + j]
            plant_state[slot + n_kept * LANES + j] = S[R.m_w + j]
        for j in range(LANES):
            seen = kept_at + (t + n_kept - int(S[R.dead_time + j])) % n_kept * LANES + j
            p = values_at(Parameters, plant_state, j, LANES)
            memory = values_at(Memory, plant_state, memory_at + j, LANES)
            now = PlantInputs(
                t, plant_state[seen + n_kept * LANES], plant_state[seen], m_a, T_a_in, W_a_in, T_w_in
            )  # fmt: skip
            T, after = step(now, p, memory)
            store_if_due(True, after, memory, plant_state, memory_at + j, LANES)
            V[VOLUME_STRIDE + T_A + j] = T
            V[VOLUME_STRIDE + T_C + j] = T
            V[VOLUME_STRIDE + W_A + j] = W_a_in

    return PLANT_SIGNATURE.compile(march, plant.fingerprint)


@section
def march_room(S, V, m_a, T_out, Q_room):
    """March the rooms of all lanes through a second of supply air; NaN in a lane without a room."""
    for j in range(LANES):
        T_sup, C_air = V[VOLUME_STRIDE + T_A + j], m_a * S[R.cp_a + j]
        S[R.T_room + j] = next_room_temperature(
            S[R.T_room + j], T_sup, C_air, T_out, S[R.room_ua + j], Q_room, S[R.room_capacity + j]
        )


@kernel
def respond_to_step(rows, config, entering, before, after, n_before, S, V, plant_state, T):
    """Run the plants of a block at openings ``before`` for n_before seconds, then at ``after``, (LANES,) each.

    entering: (5,), see ``at_rest.CONDITIONS``.  T: out, (n_steps, LANES), °C: what leaves after the step.
    """
    m_a, T_a_in, W_a_in, T_w_in, dp_ratio = entering[0], entering[1], entering[2], entering[3], entering[4]
    begin_run(S, V, rows, config.n_volumes, True, True, W_a_in)
    for t in range(n_before + T.shape[0]):
        if t == 0 or t == n_before:
            for j in range(LANES):
                S[R.opening + j] = before[j] if t < n_before else after[j]
            update_water_flow(S, config.leaks, config.is_linear)
            for j in range(LANES):
                scale_water_flow(S, j, dp_ratio)
        if t == 0:
            call_plant(config.plant, (S, V, plant_state, config.n_kept, 0, 0.0, 0.0, 0.0, 0.0, True))
        call_plant(config.plant, (S, V, plant_state, config.n_kept, t, m_a, T_a_in, W_a_in, T_w_in, False))
        if t >= n_before:
            for j in range(LANES):
                T[t - n_before, j] = V[VOLUME_STRIDE + T_A + j]
