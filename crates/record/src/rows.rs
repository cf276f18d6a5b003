//! Our own messages: one kind of row each, with the meaning of every column. Frames, units and signs are those of `CONVENTIONS.md`.

use crate::table::row;

row! {
    /// When the two pictures of a pair were taken and were there.
    Pair {
        index: u64 = "number of the pair; gaps are pairs that never arrived",
        left_capture_s: f64 = "middle of the left exposure, s on the run's clock",
        right_capture_s: f64 = "middle of the right exposure, s on the run's clock",
        left_arrival_s: f64 = "when the left picture was there, s on the run's clock",
        right_arrival_s: f64 = "when the right picture was there, s on the run's clock",
        kept: bool = "whether the pictures of this pair were handed to the recorder's queue; false: thinned, or pictures are not recorded",
        refused: Option<String> = "why the loop did not use this pair, in words; not there when it did",
    }
}

row! {
    /// One step of the loop: what it was doing, and when.
    Step {
        index: u64 = "number of the pair",
        capture_s: f64 = "mean of the two capture times, s",
        arrival_s: f64 = "when both pictures were there, s",
        command_s: f64 = "when the setpoints were given, s",
        state: String = "what the follower does: searching, tracking, occluded, lost",
        reason: String = "why",
        action: Option<String> = "what the controller does; not there for cameras that do not move",
        mode: Option<String> = "camera mode that is active or being changed to",
        refused: Option<String> = "what the controller could not use in this step, in words",
        left_x_m: f64 = "left lens in the base frame, m",
        left_y_m: f64 = "left lens in the base frame, m",
        left_z_m: f64 = "left lens in the base frame, m",
        right_x_m: f64 = "right lens in the base frame, m",
        right_y_m: f64 = "right lens in the base frame, m",
        right_z_m: f64 = "right lens in the base frame, m",
        pan_rad: f64 = "pan by the step counters and the known play, rad, + right",
        tilt_rad: f64 = "tilt, rad, + up",
        left_vergence_rad: f64 = "turn of the left camera, rad, + right",
        right_vergence_rad: f64 = "turn of the right camera, rad, + right",
        homings: u64 = "how often homing was begun before, in this run",
    }
}

row! {
    /// Where the target is, and how it moves: the filter's answer for one time.
    Estimate {
        index: u64 = "number of the pair after which it was asked",
        time_s: f64 = "the time it holds for, s",
        x_m: f64 = "position in the base frame, m, + right",
        y_m: f64 = "position in the base frame, m, + down",
        z_m: f64 = "position in the base frame, m, + forward",
        vx_m_s: f64 = "velocity in the base frame, m/s",
        vy_m_s: f64 = "velocity in the base frame, m/s",
        vz_m_s: f64 = "velocity in the base frame, m/s",
        ax_m_s2: f64 = "acceleration in the base frame, m/s²",
        ay_m_s2: f64 = "acceleration in the base frame, m/s²",
        az_m_s2: f64 = "acceleration in the base frame, m/s²",
        distance_m: f64 = "distance from the base's origin, m",
        sigma_x_m: f64 = "standard deviation of x, m",
        sigma_y_m: f64 = "standard deviation of y, m",
        sigma_z_m: f64 = "standard deviation of z, m",
        sigma_vx_m_s: f64 = "standard deviation of the velocity along x, m/s",
        sigma_vy_m_s: f64 = "standard deviation of the velocity along y, m/s",
        sigma_vz_m_s: f64 = "standard deviation of the velocity along z, m/s",
        unseen_s: f64 = "time since it was last seen, s",
        clamped: bool = "whether the answer was cut to what the filter allows",
    }
}

row! {
    /// The target in the pictures: its place, its disparity and the point that follows.
    Measurement {
        index: u64 = "number of the pair",
        anchor_u_px: f64 = "centre of the chest in the left picture, px from the left",
        anchor_v_px: f64 = "centre of the chest in the left picture, px from the top",
        anchor_sigma_px: f64 = "standard deviation of each, px",
        confidence: f64 = "quality of the sighting, 0 to 1; 0.5 is the least that counts",
        body_x_px: f64 = "left edge of the person's box, px",
        body_y_px: f64 = "upper edge of the person's box, px",
        body_w_px: f64 = "width of the person's box, px",
        body_h_px: f64 = "height of the person's box, px",
        left_u_px: Option<f64> = "measured point in the left picture, px",
        left_v_px: Option<f64> = "measured point in the left picture, px",
        right_u_px: Option<f64> = "the same point in the right picture, px",
        right_v_px: Option<f64> = "the same point in the right picture, px",
        disparity_px: Option<f64> = "u_l - u_r without lens distortion, px, + crossed",
        disparity_sigma_px: Option<f64> = "its standard deviation, px",
        x_m: Option<f64> = "the point in the base frame, m",
        y_m: Option<f64> = "the point in the base frame, m",
        z_m: Option<f64> = "the point in the base frame, m",
        patches: Option<u64> = "patches that agree",
        patches_tried: Option<u64> = "patches tried",
        verdict: Option<String> = "what the filter made of it: started, accepted, rejected, restarted",
        nis: Option<f64> = "normalised innovation squared",
        degrees: Option<u64> = "its degrees of freedom: 3 with a range, 2 without",
    }
}

row! {
    /// What was asked of the four axes after a pair.
    Setpoint {
        index: u64 = "number of the pair",
        given_s: f64 = "when it was given, s",
        pan: String = "what the pan axis was told: follow, hold, keep",
        tilt: String = "the tilt axis",
        left: String = "the left vergence axis",
        right: String = "the right vergence axis",
        time_s: Option<f64> = "the time for which the setpoints hold, s; not there when no axis follows",
        pan_rad: Option<f64> = "pan, rad, + right",
        tilt_rad: Option<f64> = "tilt, rad, + up",
        left_rad: Option<f64> = "left vergence, rad, + right",
        right_rad: Option<f64> = "right vergence, rad, + right",
        pan_rad_s: Option<f64> = "speed of pan, rad/s",
        tilt_rad_s: Option<f64> = "speed of tilt, rad/s",
        left_rad_s: Option<f64> = "speed of the left vergence, rad/s",
        right_rad_s: Option<f64> = "speed of the right vergence, rad/s",
        clamped_pan: bool = "whether a limit cut the setpoint off",
        clamped_tilt: bool = "the same for tilt",
        clamped_left: bool = "the same for left vergence",
        clamped_right: bool = "the same for right vergence",
    }
}

row! {
    /// A reading of a step counter as the loop was given it: what a replay answers with.
    Axis {
        index: u64 = "number of the pair during whose step it was read",
        axis: u64 = "which axis: 0 pan, 1 tilt, 2 left vergence, 3 right vergence",
        asked_s: f64 = "the time that was asked for, s; may be infinite for the newest one",
        time_s: f64 = "the time of the reading, s",
        position_rad: f64 = "position by the step counter, rad",
        velocity_rad_s: f64 = "velocity by the step counter, rad/s",
    }
}

row! {
    /// What a viewer sees of the target on the screen.
    Parallax {
        index: u64 = "number of the pair",
        shown_px: Option<f64> = "disparity of the target in the pair as shown, px, + crossed",
        parallax_m: Option<f64> = "the same as parallax on the screen, m, + behind it",
        parallax_arcmin: Option<f64> = "the same as an angle at the viewer, arc minutes, + behind the screen",
        shift_left_px: f64 = "electronic shift of the left picture, px, + right",
        shift_right_px: f64 = "electronic shift of the right picture, px, + right",
        nulled: f64 = "how much of the parallax is taken away, 0 to 1",
        asks_zero: bool = "whether zero parallax is asked for",
        focus_m: Option<f64> = "distance to focus on, m",
    }
}

row! {
    /// A change of the camera mode or of the controller's state.
    Change {
        time_s: f64 = "when it began, s",
        kind: String = "mode: the camera mode; control: what the controller does",
        from: String = "before",
        to: String = "after",
        reason: String = "why, in words",
    }
}

row! {
    /// Something that happened: a fault, a word of a controller, a decision of the program.
    Happening {
        time_s: f64 = "when it was noticed, s",
        level: String = "info, warning, error",
        source: String = "who says so: loop, drive, camera, recorder, supervisor",
        kind: String = "what kind, one word",
        text: String = "one sentence for a person",
    }
}

row! {
    /// What a look at the rig's health said.
    Health {
        time_s: f64 = "when the pair was taken, s",
        verdict: Option<String> = "what to make of it; not there while nothing is known",
        drift_px: Option<f64> = "RMS over the picture of how far the drift moves points off their rows, px",
        drift_sigma_px: Option<f64> = "its standard deviation, px",
        disparity_px: Option<f64> = "change of disparity in the middle by the vergence's drift, px",
        disparity_sigma_px: Option<f64> = "its standard deviation, px",
        agreeing: Option<u64> = "matched points that agree",
        corrected_pitch_rad: f64 = "turn of the right camera that the loop takes into account: pitch, rad",
        corrected_vergence_rad: f64 = "the same: vergence, rad",
        corrected_roll_rad: f64 = "the same: roll, rad",
        skipped: Option<String> = "why this pair said nothing, when it did not",
    }
}

row! {
    /// Wall time of a step; only in runs in real time, since it differs from run to run.
    Timing {
        index: u64 = "number of the pair",
        pictures_s: f64 = "grey pictures and pyramids, s",
        track_s: f64 = "finding and following, s",
        measure_s: f64 = "disparity, s",
        control_s: f64 = "filter, prediction, control law, s",
        health_s: f64 = "handing a pair to the watcher, s",
        latency_s: f64 = "from the middle of the exposure to the setpoints, s",
        waited_s: f64 = "how much of it the pair lay there before the loop took it, s",
        late_s: f64 = "how much later than it was due by the wall clock the pair was taken, s; more than a period is late",
    }
}

row! {
    /// What the twin knows.
    Truth {
        index: u64 = "number of the pair",
        x_m: f64 = "the target's reference point in the base frame, m",
        y_m: f64 = "the target's reference point in the base frame, m",
        z_m: f64 = "the target's reference point in the base frame, m",
        occluded: bool = "whether it is hidden from a camera",
        pan_rad: f64 = "true pan of the load at the capture, rad",
        tilt_rad: f64 = "true tilt, rad",
        left_rad: f64 = "true turn of the left camera, rad",
        right_rad: f64 = "true turn of the right camera, rad",
        disparity_px: Option<f64> = "disparity of the reference point without lens distortion, px",
        left_u_px: Option<f64> = "the reference point in the left picture, px",
        left_v_px: Option<f64> = "the reference point in the left picture, px",
        pointing_px: Option<f64> = "its distance from the principal point, mean of both eyes, px",
    }
}

row! {
    /// How the recorder itself fares; written when one of its counts changes.
    Recorder {
        time_s: f64 = "when, s",
        pictures_thinned: u64 = "pairs whose pictures were left out so far, because the disk or the encoder was too slow or full",
        numbers_lost: u64 = "messages lost so far: only when the disk takes nothing for minutes",
        every: u64 = "one pair in how many keeps its pictures now",
        failed: Option<String> = "why the disk takes nothing now",
    }
}

row! {
    /// One camera, as the loop believes it, and where it stands if it does not move: every bit, for replays.
    Lens {
        eye: u64 = "0 left, 1 right",
        width_px: u64 = "width of the pictures, px",
        height_px: u64 = "height of the pictures, px",
        fx_px: f64 = "focal length along u, px",
        fy_px: f64 = "focal length along v, px",
        cx_px: f64 = "principal point, px from the left",
        cy_px: f64 = "principal point, px from the top",
        model: String = "brown-conrady or kannala-brandt",
        c0: f64 = "coefficient 1 in OpenCV's order (k1)",
        c1: f64 = "coefficient 2 (k2)",
        c2: f64 = "coefficient 3 (p1, or k3 of Kannala–Brandt)",
        c3: f64 = "coefficient 4 (p2, or k4 of Kannala–Brandt)",
        c4: f64 = "coefficient 5 (k3)",
        c5: f64 = "coefficient 6 (k4)",
        c6: f64 = "coefficient 7 (k5)",
        c7: f64 = "coefficient 8 (k6)",
        fixed: bool = "whether the camera stands still, at the pose that follows",
        x_m: f64 = "the lens in the base frame, m",
        y_m: f64 = "the lens in the base frame, m",
        z_m: f64 = "the lens in the base frame, m",
        qx: f64 = "base_from_cam as a unit quaternion, i",
        qy: f64 = "j",
        qz: f64 = "k",
        qw: f64 = "real part",
        fps: f64 = "nominal pictures a second",
    }
}

row! {
    /// What was counted of live cameras since the start of the run and measured of their times: once a second, and at the end.
    Cameras {
        time_s: f64 = "when, s on the run's clock",
        left_frames: u64 = "pictures of the left camera that came whole",
        left_lost: u64 = "pictures that the left camera lost, by the numbers of its driver",
        left_torn: u64 = "damaged pictures of the left camera, not used",
        left_frozen: u64 = "pictures of the left camera while it was frozen, not used",
        left_overrun: u64 = "pictures of the left camera that the loop did not fetch in time",
        left_late: u64 = "pictures of the left camera that took over half a period longer than usual",
        left_gone: u64 = "how often the left camera went",
        left_back: u64 = "how often the left camera was found again",
        left_clock_jumps: u64 = "how often the clock of the left camera jumped",
        left_period_s: Option<f64> = "usual time from one picture of the left camera to the next, s: the median of the newest 1024",
        left_jitter_s: Option<f64> = "half of these times lie nearer to the usual one, s",
        left_jitter_p95_s: Option<f64> = "95 % of them lie nearer to it, s",
        left_jitter_max_s: Option<f64> = "the furthest that one lay from it since the start, s",
        left_latency_s: Option<f64> = "usual time from the capture of the left camera's pictures to their arrival, s: the median of the newest 1024",
        left_latency_max_s: Option<f64> = "the longest since the start, s",
        right_frames: u64 = "pictures of the right camera that came whole",
        right_lost: u64 = "pictures that the right camera lost, by the numbers of its driver",
        right_torn: u64 = "damaged pictures of the right camera, not used",
        right_frozen: u64 = "pictures of the right camera while it was frozen, not used",
        right_overrun: u64 = "pictures of the right camera that the loop did not fetch in time",
        right_late: u64 = "pictures of the right camera that took over half a period longer than usual",
        right_gone: u64 = "how often the right camera went",
        right_back: u64 = "how often the right camera was found again",
        right_clock_jumps: u64 = "how often the clock of the right camera jumped",
        right_period_s: Option<f64> = "usual time from one picture of the right camera to the next, s: the median of the newest 1024",
        right_jitter_s: Option<f64> = "half of these times lie nearer to the usual one, s",
        right_jitter_p95_s: Option<f64> = "95 % of them lie nearer to it, s",
        right_jitter_max_s: Option<f64> = "the furthest that one lay from it since the start, s",
        right_latency_s: Option<f64> = "usual time from the capture of the right camera's pictures to their arrival, s: the median of the newest 1024",
        right_latency_max_s: Option<f64> = "the longest since the start, s",
        paired: u64 = "pairs that were made of the pictures",
        unpaired: u64 = "pictures without a partner near enough",
        doubled: u64 = "pictures that came twice",
        backwards: u64 = "pictures stamped before one that came earlier",
        overflowed: u64 = "pictures that waited too long for a partner",
        untimed: u64 = "pictures without a time",
        lost_pairs: u64 = "moments of which there was a picture and no pair",
        skipped_pairs: u64 = "pairs that the loop did not fetch in time",
        too_far_apart: u64 = "pairs further apart than the limit, not used",
        stalls: u64 = "how often no pair came within the time that was waited",
        skew_s: Option<f64> = "usual time between the two pictures of a pair without the steady offset, s: the median of the newest 1024",
        skew_p95_s: Option<f64> = "95 % of the pairs are nearer to each other, s",
        skew_max_s: Option<f64> = "the furthest apart since the start, s",
        offset_s: Option<f64> = "the steady offset, right times minus left times, s; not there while none is known",
    }
}
