//! Stereo camera backend that replays recorded pairs.
