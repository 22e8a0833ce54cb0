"""What a log tells before any choice: noise, horizon, rate, and the laws of contact and time steps that it supports."""
