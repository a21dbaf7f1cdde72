"""What a calibration costs: time, accuracy, computing; see __main__."""
