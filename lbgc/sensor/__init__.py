"""The errors of an IMU: noise terms, the error model, its datasheet keys, and their estimation from
recordings by fit, Allan analysis and calibration."""
