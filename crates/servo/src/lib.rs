//! The loop: from a pair of pictures to setpoints for the axes.
