"""How wrong models are on a log: one step and open loop, by stratum (`cmbrl error`)."""
