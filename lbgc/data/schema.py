"""What a dataset holds: every variable, its dimensions, unit and name."""

from dataclasses import dataclass

from lbgc.frames import AXES as AXES
from lbgc.protocol import STAGES

SCHEMA = 5
"""Changes whenever the same configuration would give other bytes, or a reader would be misled."""
READ = (4, 5)
"""The schemas that are read; only the last is written. Up to 4 a shard had a file of every variable
and two of its row in the manifest, and names had directories where they have dots now."""

SPLITS = ("train", "validation", "test")


@dataclass(frozen=True)
class Variable:
    """A variable as it is stored: its dimensions, type, unit, name and what its flags mean."""

    dims: tuple[str, ...]
    dtype: str
    units: str
    long_name: str
    flags: tuple[str, ...] = ()
    optional: bool = False
    """Whether only those datasets have it in which it is drawn. What came to the schema after it
    was numbered is optional, so that datasets from before stay as they are and can be read."""


RECORDED = ("recording", "time", "axis")
_PER_RECORDING = ("recording",)
_VECTOR = ("recording", "axis")
_MATRIX = ("recording", "axis", "axis_in")

_OFF = ("free", "saturated")
_CAME = ("came", "lost")
_TRIADS = (("gyro", "rad s-1", "angular rate"), ("accel", "m s-2", "specific force"))
VARIABLES: dict[str, Variable] = {
    "gyro": Variable(RECORDED, "", "rad s-1", "angular rate omega_ib_b, as the sensor gives it"),
    "accel": Variable(RECORDED, "", "m s-2", "specific force f_ib_b, as the sensor gives it"),
    "plate_angle": Variable(
        ("recording", "time"), "float64", "rad", "plate angle as the encoder reads it"
    ),
    "gyro_saturated": Variable(("recording", "time"), "int8", "1", "a gyro is at its range", _OFF),
    "accel_saturated": Variable(
        ("recording", "time"), "int8", "1", "an accelerometer is at its range", _OFF
    ),
    "time_error": Variable(
        ("recording", "time"), "float32", "s", "printed time of a sample less its true time"
    ),
    "lost": Variable(
        ("recording", "time"), "int8", "1", "a sample that repeats the last one that came", _CAME
    ),
    "stage": Variable(("recording", "time"), "int8", "1", "what the plate is doing", STAGES),
    "heading": Variable(
        _PER_RECORDING, "float64", "rad", "true heading when the encoder reads zero"
    ),
    "heading_reference": Variable(
        _PER_RECORDING, "float64", "rad", "the control module's word for the heading"
    ),
    "roll": Variable(_PER_RECORDING, "float64", "rad", "true roll at the start"),
    "pitch": Variable(_PER_RECORDING, "float64", "rad", "true pitch at the start"),
    "latitude": Variable(_PER_RECORDING, "float64", "rad", "geodetic latitude"),
    "attitude": Variable(
        RECORDED,
        "float32",
        "rad",
        "true roll, pitch, and heading less its label and the plate's angle",
    ),
    "base_azimuth": Variable(_PER_RECORDING, "float64", "rad", "azimuth of the base"),
    **{
        name: Variable(dims, dtype, unit, f"drawn {long}; 0 where it is off")
        for name, dims, dtype, unit, long in (
            ("base_roll", _PER_RECORDING, "float64", "rad", "roll of the base"),
            ("base_pitch", _PER_RECORDING, "float64", "rad", "pitch of the base"),
            ("sway_level", _PER_RECORDING, "float64", "1", "level of the sway"),
            ("vibration_level", _PER_RECORDING, "float64", "1", "level of the floor's vibration"),
            ("vibration_frequency", _PER_RECORDING, "float64", "Hz", "frequency of it"),
            ("vibration_drift", _PER_RECORDING, "float64", "Hz", "swing of that frequency"),
            ("vibration_phase", _VECTOR, "float64", "rad", "phases of its rotation"),
            ("vibration_force_phase", _VECTOR, "float64", "rad", "phases of its translation"),
            ("vibration_drift_phase", _PER_RECORDING, "float64", "rad", "phase of the swing"),
            ("knock_rate", _PER_RECORDING, "float64", "s-1", "mean rate of knocks"),
            ("knock_count", _PER_RECORDING, "int32", "1", "number of knocks"),
            ("knock_peak", _PER_RECORDING, "float64", "m s-2", "1 sigma of their acceleration"),
            ("knock_tilt", _PER_RECORDING, "float64", "rad", "1 sigma of their tilt"),
            ("knock_frequency", _PER_RECORDING, "float64", "Hz", "frequency of their swinging"),
            ("floor_tilt_rate", _PER_RECORDING, "float64", "rad s-1", "rate of the floor's tilt"),
            ("floor_tilt_direction", _PER_RECORDING, "float64", "rad", "axis of it"),
            ("moored_roll", _PER_RECORDING, "float64", "rad", "rms roll of the moored platform"),
            ("moored_pitch", _PER_RECORDING, "float64", "rad", "rms pitch of it"),
            ("moored_heave", _PER_RECORDING, "float64", "m", "rms heave of it"),
            ("moored_period", _PER_RECORDING, "float64", "s", "period of its waves"),
        )
    },
    "settling_time": Variable(
        _PER_RECORDING, "float64", "s", "physics run until the plate had settled"
    ),
    "unit": Variable(_PER_RECORDING, "int32", "1", "serial number of the sensor"),
    "session": Variable(_PER_RECORDING, "int32", "1", "power-up of that sensor"),
    "split": Variable(_PER_RECORDING, "int8", "1", "part of the dataset", SPLITS),
    **{
        f"{triad}_{name}": Variable(dims, "float64", units if units else unit, long.format(what))
        for triad, unit, what in _TRIADS
        for name, dims, units, long in (
            ("bias_unit", _VECTOR, "", "drawn {} bias of the unit"),
            ("bias_session", _VECTOR, "", "drawn {} bias of the session"),
            ("bias_run", _VECTOR, "", "drawn {} bias of the recording"),
            ("matrix", _MATRIX, "1", "drawn scale and misalignment M of the {}"),
            ("tone_phase", _VECTOR, "rad", "drawn phase of the {} tone at the start"),
            ("ramp_sign", _VECTOR, "1", "drawn sign of the {} ramp"),
            ("bias_per_k", _VECTOR, f"{unit} K-1", "drawn temperature coefficient of the {} bias"),
            ("scale_per_k", _VECTOR, "K-1", "drawn temperature coefficient of the {} scale"),
            ("g_sensitivity", _MATRIX, f"{unit} / (m s-2)", "drawn {} per specific force"),
        )
    },
    "gyro_magnetic": Variable(
        _MATRIX, "float64", "rad s-1 T-1", "drawn gyro per magnetic field", optional=True
    ),
}
ALWAYS = tuple(name for name, variable in VARIABLES.items() if not variable.optional)
"""What every dataset has."""
