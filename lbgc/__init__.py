"""lbgc: how well, and how fast, can this IMU find north, and does learning help?

The conventions of the whole project stand here and nowhere else.

Frames
    n is North-East-Down. b, the body, is Forward-Right-Down. ``C_nb`` takes a vector's
    components from b to n. Heading psi is clockwise from true north; roll, pitch and yaw are
    z-y-x Euler angles (the paper's T_b^n, its eq. 8). ``omega_ib_b`` is the angular rate of the
    body relative to inertial space, in b; ``f_ib_b`` is the specific force, in b.

    A level IMU at rest reads ``omega_ib_b = Omega [cos(lat) cos(psi), -cos(lat) sin(psi),
    -sin(lat)]`` and ``f_ib_b = [0, 0, -g]``. To first order, level, the heading's error
    (estimate minus truth) is ``-(dw_x sin psi + dw_y cos psi) / (Omega cos lat)
    + tan(lat) (df_x sin psi + df_y cos psi) / g``. The paper's eq. 24 is the special case
    psi = 0 of it, with the opposite sign.

Samples
    A sample is the *mean over its interval* (t_k - dt, t_k]: the sensor integrates. The truth is
    averaged over the same interval. So means over blocks of samples are themselves samples, at a
    lower rate, of the same process.

Labels
    ``heading`` is the test module's true heading when the plate's encoder reads zero; the encoder
    is zeroed at each recording's start. Heading at a time is ``heading + plate_angle`` of a plate
    about down; one about the body's forward or right axis is level at angle zero. Angles are
    positive by the right-hand rule about the body's axis.
    A log's angle is as its user states it; its heading is where that is zero.
    ``heading_reference`` is what the control module's erring reading implies for it: train on the
    reference, score on the truth; real logs have only a reference, and results say so.

Units
    SI and radians inside. Datasheet units live at the edges (YAML, command line, tables, plots)
    with the unit in the key, ``arw_deg_per_sqrt_h``; ``lbgc.units`` converts them, once. The one
    key without its unit is ``latitude``, in degrees.

Noise coefficients
    IEEE Std 952's: N white (angle random walk), B bias instability (the Allan deviation's flat
    level is sqrt(2 ln 2 / pi) B = 0.664 B), K rate random walk. PSDs are two-sided.
"""

__version__ = "0.1.0"
