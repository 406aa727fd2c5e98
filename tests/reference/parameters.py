"""The parameters of a scenario and their values for a coil like the paper's."""

PAPER_LIKE = {
    # Coil, Eqs (3) and (4); C_w, C_c, beta1, beta3 and beta5 are those of one of 8 volumes.
    "C_w": 8.8,
    "C_c": 30.0,
    "beta1": 0.32,
    "beta2": -0.20,
    "beta3": 0.40,
    "beta4": -0.45,
    "beta5": 0.42,
    "beta6": -0.42,
    "cp_w": 4.186,
    "cp_a": 1.02,
    "pressure": 101325.0,
    "n_volumes": 8,
    "air_march": "lagged",
    "T_initial": 20.0,
    # Valve, Eq (2).
    "m_max": 2.0,
    "valve_a": 0.7,
    "valve_b": 9.0,
    "valve_c": 0.38,
    # Actuator, Eq (1).
    "backlash": 0.07,
    "stroke_time": 0.0,
    "command_resolution": 0.0,
    # Sensor.
    "sensor_time_constant": 0.0,
    "noise_std": 0.0,
    "sensor_resolution": 0.0,
    # PI controller and backlash inverse.
    "kp": 0.03,
    "ti": 8.0,
    "sample_time": 30.0,
    "action": "cooling",
    "backlash_estimate": 0.0,
    "buffer": 1e-9,
    "plant_gain": None,
    # What finds the estimate: None is the learner where learning_step > 0.
    "estimator": None,
    "estimate_share": 1.0,
    # Learner.
    "learning_step": 0.0,
    "learning_interval": 1800.0,
    "learning_ratio": 2.0,
    "learning_floor": 0.0,
    "learning_cap": 0.25,
    "learning_min_switches": 0.0,
    "learning_max_reference": 1.0,
    "learning_early_trip": 0,
    "learning_growth": 1.0,
    "learning_shrink": 1.0,
    "learning_final": 1.0,
    "learning_stop": "never",
    # Half periods of the error.
    "hagglund_filter_ratio": 0.1,
    "hagglund_least_half_periods": 10,
    # Adaptive inverse.
    "gradient_gain": 3e-4,
    "gradient_filter_time": 60.0,
    "gradient_reference_time": 60.0,
    "gradient_dead_zone": 0.05,
    "gradient_pause": 400.0,
    "gradient_cap": 0.2,
}
