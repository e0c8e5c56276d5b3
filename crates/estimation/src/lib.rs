//! Projection-based 3D perception: pose of an unknown object from one stereo pair.
