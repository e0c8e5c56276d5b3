//! Calibration files, datasets, and reports: readers and writers.
