//! The equations of Yang, Xu, Lv & Song, "Analysis of Camera Arrays Applicable to the Internet of Things", Sensors
//! 2016, 16(3), 421, in the paper's own symbols and signs, with corrections where it errs.
//!
//! Signs. In Equations (1) to (16) the sensor coordinates are those of the **inverted** picture, so that
//! `h = -p`, `v = -q`, `x = -X`, `y = -Y`, `z = +Z` in the terms of [`crate::viewing`]: h > 0 is *in front of* the screen,
//! where the trade writes negative parallax. Equations (17) to (19) are in upright signs.
//!
//! These functions are the paper as a reader finds it, for comparison; [`crate::array`] is what the program uses. They
//! return NaN or meaningless numbers where the paper's formulas do (each says where); they check nothing.
//!
//! | where | printed | right |
//! |---|---|---|
//! | before (2) | theta between AE and AF, BE and BF | between the optical axes AC, BC and AF, BF |
//! | (4), (5) | length AF, BF | *depth*: AF, BF projected on the optical axis |
//! | (10) | h/e = z/(V - z) | in the inverted signs only |
//! | (10), (13)-(15) | no limit | only while h > -e |
//! | (14) | y | half-way height where the rays cross in plan; with v != 0 they do not meet |
//! | (16) | z < 0 | z = +V M f t / (e z0 + M f t) |
//! | (17) | v | the negative of (12): upright sign |
//! | (18) | t << L | also t << z0 and t abs(x0) << 2 L z0 |
//! | (19) | range of v | range of an upper bound of v; "tfm" is t f M |
//! | (2), (3), (11), (13) | tan(beta - arctan(...)) | divides by zero at z0 = 0, answers behind the cameras |

/// The paper's rig before the paper's screen, in metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PaperRig {
    /// Separation of the lens centres.
    pub t: f64,
    /// Focal length.
    pub f: f64,
    /// Screen magnification.
    pub m: f64,
    /// Separation of the eyes.
    pub e: f64,
    /// Viewing distance.
    pub v: f64,
    /// Convergence distance.
    pub l: f64,
}

/// The target F, metres: x0 right, y0 up, z0 forward.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Target {
    /// To the right.
    pub x0: f64,
    /// Up.
    pub y0: f64,
    /// Forward.
    pub z0: f64,
}

impl PaperRig {
    /// (1): `beta = arctan(t / 2L)`, the turn of each camera, radians.
    pub fn eq1_beta(&self) -> f64 {
        (self.t / (2.0 * self.l)).atan()
    }

    /// (2): angles theta_1, theta_2 between the optical axes and the rays to the target, radians:
    /// `beta - arctan((t + 2 x0) / 2 z0)` and `beta - arctan((t - 2 x0) / 2 z0)`. NaN or wrong at z0 <= 0.
    pub fn eq2_theta(&self, target: &Target) -> [f64; 2] {
        let beta = self.eq1_beta();
        [
            beta - ((self.t + 2.0 * target.x0) / (2.0 * target.z0)).atan(),
            beta - ((self.t - 2.0 * target.x0) / (2.0 * target.z0)).atan(),
        ]
    }

    /// (3): inverted sensor x, left and right: `f tan(theta_1)`, `-f tan(theta_2)`.
    pub fn eq3_x(&self, target: &Target) -> [f64; 2] {
        let [left, right] = self.eq2_theta(target);
        [self.f * left.tan(), -self.f * right.tan()]
    }

    /// (4), (5): what the paper calls AF and BF, corrected: the depths of the target along the two optical axes.
    pub fn eq4_5_depth(&self, target: &Target) -> [f64; 2] {
        let [left, right] = self.eq2_theta(target);
        let half = self.t / 2.0;
        [
            (target.x0 + half).hypot(target.z0) * left.cos(),
            (target.x0 - half).hypot(target.z0) * right.cos(),
        ]
    }

    /// (4), (5) as their letters say: the lengths AF and BF in plan, which exceed the depths off the axis.
    pub fn eq4_5_length(&self, target: &Target) -> [f64; 2] {
        let half = self.t / 2.0;
        [
            (target.x0 + half).hypot(target.z0),
            (target.x0 - half).hypot(target.z0),
        ]
    }

    /// (6), (7): inverted sensor y, left and right: `-f y0 / depth`.
    pub fn eq6_7_y(&self, target: &Target) -> [f64; 2] {
        self.eq4_5_depth(target)
            .map(|depth| -self.f * target.y0 / depth)
    }

    /// (8): h from the inverted sensor positions, `M (x_r - x_l)`.
    pub fn eq8_h(&self, x: [f64; 2]) -> f64 {
        self.m * (x[1] - x[0])
    }

    /// (9): v from the inverted sensor positions, `M (y_r - y_l)`.
    pub fn eq9_v(&self, y: [f64; 2]) -> f64 {
        self.m * (y[1] - y[0])
    }

    /// (10): h of a point seen z in front of the screen, `e z / (V - z)`.
    pub fn eq10_h(&self, z: f64) -> f64 {
        self.e * z / (self.v - z)
    }

    /// (11): h of a target, `-M f [tan(beta - arctan((t - 2 x0) / 2 z0)) + tan(beta - arctan((t + 2 x0) / 2 z0))]`.
    pub fn eq11_h(&self, target: &Target) -> f64 {
        let [left, right] = self.eq2_theta(target);
        -self.m * self.f * (right.tan() + left.tan())
    }

    /// (12): v of a target, `-M f y0 (1 / depth_r - 1 / depth_l)`.
    pub fn eq12_v(&self, target: &Target) -> f64 {
        let [left, right] = self.eq4_5_depth(target);
        -self.m * self.f * target.y0 * (1.0 / right - 1.0 / left)
    }

    /// (13): x of the seen point, `e (x_l + x_r) M / 2 (e + h)`, inverted sign; only while h > -e.
    pub fn eq13_x(&self, target: &Target) -> f64 {
        let [left, right] = self.eq3_x(target);
        self.e * self.m * (left + right) / (2.0 * (self.e + self.eq11_h(target)))
    }

    /// (14): y of the seen point, `e (y_l + y_r) M / 2 (e + h)`, inverted sign: the half-way height where the rays cross
    /// in plan; only while h > -e.
    pub fn eq14_y(&self, target: &Target) -> f64 {
        let [left, right] = self.eq6_7_y(target);
        self.e * self.m * (left + right) / (2.0 * (self.e + self.eq11_h(target)))
    }

    /// (15): z of the seen point, `V h / (e + h)`, + towards the viewer; only while h > -e.
    pub fn eq15_z(&self, target: &Target) -> f64 {
        let h = self.eq11_h(target);
        self.v * h / (self.e + h)
    }

    /// (16), parallel cameras: `h = M f t / z0` and v = 0.
    pub fn eq16_parallel_h_v(&self, target: &Target) -> [f64; 2] {
        [self.m * self.f * self.t / target.z0, 0.0]
    }

    /// (16), parallel cameras, corrected: the seen point
    /// `(-M f e x0, -M f e y0, +V M f t) / (e z0 + M f t)`.
    pub fn eq16_parallel_seen(&self, target: &Target) -> [f64; 3] {
        let mf = self.m * self.f;
        let below = self.e * target.z0 + mf * self.t;
        [
            -mf * self.e * target.x0 / below,
            -mf * self.e * target.y0 / below,
            self.v * mf * self.t / below,
        ]
    }

    /// (16) as printed: z with the wrong sign. (15) with beta = 0 contradicts it.
    pub fn eq16_parallel_z_as_printed(&self, target: &Target) -> f64 {
        -self.eq16_parallel_seen(target)[2]
    }

    /// (17): v in **upright** sign, the negative of (12):
    /// `2 t f M sqrt(4 L² + t²) x0 y0 / ((2 L z0 + t²/2)² - (t x0)²)`.
    pub fn eq17_v_upright(&self, target: &Target) -> f64 {
        let (t, l) = (self.t, self.l);
        let depth = 2.0 * l * target.z0 + t * t / 2.0;
        let side = t * target.x0;
        2.0 * t * self.f * self.m * (2.0 * l).hypot(t) * target.x0 * target.y0
            / (depth * depth - side * side)
    }

    /// (18): (17) to first order in t, `t f M x0 y0 / (L z0²)`, upright sign. Larger than (17) by at most
    /// `(1 + t²/4 L z0)² / sqrt(1 + t²/4 L²)`: within 0.19 % for t <= 70 mm and L, z0 >= 1 m; 6 % off at t = 0.2 m,
    /// L = z0 = 0.5 m.
    pub fn eq18_v_upright(&self, target: &Target) -> f64 {
        self.t * self.f * self.m * target.x0 * target.y0 / (self.l * target.z0 * target.z0)
    }

    /// (19): the bound `t f M / L` of (18) as x0 and y0 approach z0, upright sign. The lens sees no such corner: at
    /// L = 1 m the largest v in a 1/2 inch picture is 4.13 mm, in a 1/3 inch one (4.8 x 3.6 mm) 2.32 mm, not 22.75 mm.
    pub fn eq19_bound(&self) -> f64 {
        self.t * self.f * self.m / self.l
    }
}
