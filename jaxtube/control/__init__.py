"""Control laws of the robot: `protocol.Controller` and its implementations in `laws`; the MPC in
`mpc`, its plans in `planning`."""
