//! Visual-servo controller: control law and supervisor as step(state, now).
