"""The gap between measured and simulated torque, and which samples of it are used."""
