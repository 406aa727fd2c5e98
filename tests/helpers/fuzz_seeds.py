"""Sound studies, logs and weather files, and values to put into them."""

STUDIES = (
    """title = "Größe"
question = 'why?'
[loop]
preset = "lbnl"
include = ["valve.toml"]
noise_std = 0.05
[sweep]
backlash = [0.02, 0.05, 0.07]
estimate_ratio = { linspace = [0.0, 1.4, 5] }
ti = { geomspace = [8, 80, 4] }
[cases.tuning]
slow = { kp = 0.018 }
"f a s t" = { kp = 0.03 }
[run]
seed = 7
replicates = 2
warm_up = 600
traces = ["T_sup", "command"]
[boundary]
kind = "paper_day"
hours = 1
seed = [1, 2, 3]
""",
    """[loop]
learning_step = 0.007
[sample]
method = "sobol"
size = 16
seed = 3
backlash = { uniform = [0.02, 0.15] }
ti = { loguniform = [5, 50] }
kp = { truncnorm = [0.02, 0.01, 0.005, 0.1] }
buffer = { triangular = [0.0, 0.001, 0.01] }
sample_time = { choice = [5, 10, 30] }
[boundary]
kind = "design_day"
hours = 1.0
start_hour = 9
T_design = 33.0
""",
    """[loop]
rangeability = 40
authority = 0.4
m_full = 1.5
[sample]
method = "saltelli"
size = 8
backlash = { uniform = [0.02, 0.15] }
[boundary]
kind = "csv"
path = "log.csv"
start = 0.0
hours = 0.6
max_gap = 600
units = { T_set = "degC" }
columns = { T_set = "T_set" }
""",
    """[loop]
[sweep]
air_march = ["lagged", "quasistatic"]
[boundary]
kind = "weather"
path = "weather.csv"
m_a = 1.15
T_w_in = 7
T_set = 14.0
outdoor_fraction = 0.3
T_return = 24.0
RH_return = 0.5
hours = 2
days = [1]
hour = 3
columns = { RH = "RH_pct" }
""",
)
VALVE = "[loop]\nbacklash = 0.07\nm_max = 1.9\nvalve_a = 0.7\nvalve_b = 9.0\nvalve_c = 0.4\n[fit]\nkind = 'valve'\n"
LOG = "timestamp,m_a [kg/s],T_a_in [degC],RH_a_in [percent],T_w_in [degC],T_set,command,m_w [kg/s],batch\n" + "".join(
    f"2024-07-01T{8 + k // 60:02}:{k % 60:02}:00,1.{k % 9},25.{k % 7},5{k % 9},7.{k % 3},14,0.{k % 10},0.{k % 8},1\n"
    for k in range(40)
)
TIMED = "elapsed_time [s],m_a [m3/h],T_a_in [degF],W_a_in [g/kg],T_w_in [degC],T_set [degC],T_sup [degC]\n" + "".join(
    f"{60 * k},{3000 + k},7{k % 9}.5,9.{k % 10},7.1,14,1{k % 6}.2\n" for k in range(40)
)
FOREIGN = (
    "Trend report\nSite:;Berkeley\n\nZeit;m_a;T_a_in;RH_a_in;T_w_in;T_set;command;m_w;enabled;Status\n"
    ";kg/s;°C;%;°C;°C;%;l/min;;\n"
    + "".join(
        f"{1 + k // 20}.07.2024 8:{k:02};1,{k % 9};25,{k % 7};5{k % 9};7,{k % 3};14;{k % 10},5;1.20{k % 8},5;"
        f"{'On' if k % 5 else 'Off'};{{ok}}\n"
        for k in range(40)
    )
    + "\nEnd of report\n"
)
WEATHER = "hour_of_year,month,day,hour,T_drybulb_C,T_dewpoint_C,RH_pct,p_Pa\n" + "".join(
    f"{k},1,{1 + k // 24},{k % 24},{7 + k % 20},{k % 7},60,10{k % 9}000\n" for k in range(1, 60)
)
VALUES = (
    "1e308", "-1e308", "nan", "inf", "-inf", "-1", "0", "-0.0", "1e-320", "9" * 30, "9" * 400, "9" * 5000,
    "0x" + "f" * 5000, "true", '""', '"x"', "'" + "y" * 100_000 + "'", "2024-07-01", "2024-07-01T08:00:00+14:00",
    "07:30:00", "[]", "{}", "[[1], [2]]", "[" * 400 + "]" * 400, "[" * 5000, "{ a = " * 300 + "1" + " }" * 300,
    "{ linspace = [0, 1, 10000000] }", "{ linspace = [0.0, 1.0, 1000000] }", "[" + "1, " * 20_000 + "]", '"\\u0000"',
    '"\\u202e\\u001b[2J"', "10000000", "4294967296", "1_000", "1e6", "18446744073709551615", '["T_sup", "T_sup"]',
    "[" + '"nothing", ' * 20_000 + "]", '"/dev/zero"', '"../../../../dev/zero"', '["/dev/zero"]',
    '["' + "z" * 300 + '"]',
)  # fmt: skip
CELLS = (
    "1e308", "-1e308", "nan", "inf", "-1", "", " ", "9" * 400, "1e-320", "x" * 1000, '"a\nb"', "2024-13-01",
    "9999-12-31", "0001-01-01T00:00:00+14:00", "2024-07-01T08:00:00Z", "1,5", "1;5", "\x00", "\x1b[2J", "#N/A", "１２",
    "1_0", "0x10", "1,234", "1.234,5", "5.12 V", "47 %", "{fault}", "3 {down}", "On", "13/07/2024 8:05 PM",
    "07/13/2024", "1-Jul-24 08:05:00 AM PDT", "45474.5", "1719820800", "1719820800000", "31.02.2024", "24:00",
    "12,5", "---",
)  # fmt: skip
LINES = (
    *("a." * n + "b = 1" for n in (3, 30, 20_000)), "[" + "a." * 20_000 + "b]", '"q".' * 5000 + "b = 1",
    "\n".join(f"x{i} = 1" for i in range(5000)), "\n".join(f"[cases.d{i}.c]\nkp = 1" for i in range(500)),
    "k" * 100_000 + " = 1", '"""' + '\\"""' * 20_000, '"' + '\\"' * 20_000, "'''" * 20_001, '"\\u0000" = 1', "[[loop]]",
    "[[cases.tuning]]", "[run]\nreduce = 'nobody:f'", "[loop]",
)  # fmt: skip
