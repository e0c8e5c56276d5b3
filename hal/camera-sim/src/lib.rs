//! Stereo camera backend that renders the simulated cell.
