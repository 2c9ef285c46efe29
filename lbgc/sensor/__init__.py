"""What an IMU does to the truth: its noise terms, its error model, and Allan analysis."""
