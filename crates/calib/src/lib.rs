//! Camera and rig calibration files.
