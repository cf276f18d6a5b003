//! Faults planted at known strength into one picture of a pair, by resampling in double precision (Lanczos, 6 x 6 samples).
//!
//! Written without the code under test: the maps go from the faulty picture's pixel back to the faultless one's.

use vergence_imaging::Rgb;

/// What is done to a picture, from its centre; pixels of the picture. In this order: keystone, lens, zoom and roll, offset, then the
/// values: gain, blur, noise.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Plant {
    /// Moved down, px.
    pub(crate) down_px: f64,
    /// Turned clockwise, degrees.
    pub(crate) clockwise_deg: f64,
    /// Enlarged, percent.
    pub(crate) larger_percent: f64,
    /// Keystone of a turn to the side: points move outwards by this part at the right edge (`y (1 + k x)`, x from -1 to 1).
    pub(crate) toe_in: f64,
    /// Keystone of a tilt: the same at the lower edge, x and y by `1 + e y` with y in half widths.
    pub(crate) tilt: f64,
    /// Radial distortion `r (1 + q r²)`, r in half widths.
    pub(crate) lens: f64,
    /// Values times this.
    pub(crate) gain: f64,
    /// Gaussian blur, px.
    pub(crate) blur_px: f64,
    /// Gaussian noise, grey levels.
    pub(crate) noise: f64,
}

impl Plant {
    pub(crate) const NOTHING: Self = Self {
        down_px: 0.0,
        clockwise_deg: 0.0,
        larger_percent: 0.0,
        toe_in: 0.0,
        tilt: 0.0,
        lens: 0.0,
        gain: 1.0,
        blur_px: 0.0,
        noise: 0.0,
    };

    /// The faultless pixel (from the centre) that is seen at a pixel (from the centre) of the faulty picture.
    pub(crate) fn source(&self, [x, y]: [f64; 2], half_width: f64) -> [f64; 2] {
        let (sin, cos) = self.clockwise_deg.to_radians().sin_cos();
        let scale = 1.0 + self.larger_percent / 100.0;
        let y = y - self.down_px;
        let (x, y) = ((x * cos + y * sin) / scale, (y * cos - x * sin) / scale);
        // r' = r (1 + q r²), solved for r by substitution.
        let (mut sx, mut sy) = (x, y);
        for _ in 0..30 {
            let square = (sx * sx + sy * sy) / (half_width * half_width);
            let factor = 1.0 + self.lens * square;
            (sx, sy) = (x / factor, y / factor);
        }
        // q = p / (1 - k p.x - e p.y), so p = q / (1 + k q.x + e q.y).
        let over = 1.0 + (self.toe_in * sx + self.tilt * sy) / half_width;
        [sx / over, sy / over]
    }

    /// The faulty picture.
    pub(crate) fn planted_in(&self, picture: &Rgb, seed: u64) -> Rgb {
        let mut values = self.moved(picture);
        if self.blur_px > 0.0 {
            values = blurred(&values, picture.size(), self.blur_px);
        }
        let mut random = Random(seed);
        let (w, h) = picture.size();
        let samples = values
            .iter()
            .map(|px| {
                px.map(|v| {
                    let noise = if self.noise > 0.0 {
                        self.noise * random.normal()
                    } else {
                        0.0
                    };
                    (v * self.gain + noise).round().clamp(0.0, 255.0) as u8
                })
            })
            .collect();
        Rgb::from_samples(w, h, samples)
    }

    fn moved(&self, picture: &Rgb) -> Vec<[f64; 3]> {
        let (w, h) = picture.size();
        let (cx, cy) = ((w as f64 - 1.0) / 2.0, (h as f64 - 1.0) / 2.0);
        let still = [
            self.down_px,
            self.clockwise_deg,
            self.larger_percent,
            self.toe_in,
            self.tilt,
            self.lens,
        ]
        .iter()
        .all(|&v| v == 0.0);
        let mut out = Vec::with_capacity(w * h);
        for y in 0..h {
            for x in 0..w {
                if still {
                    out.push(picture.at(x, y).map(f64::from));
                    continue;
                }
                let [sx, sy] = self.source([x as f64 - cx, y as f64 - cy], w as f64 / 2.0);
                out.push(sampled(picture, sx + cx, sy + cy));
            }
        }
        out
    }
}

/// Lanczos of three lobes; outside the picture its edge is repeated.
fn sampled(picture: &Rgb, x: f64, y: f64) -> [f64; 3] {
    let (w, h) = picture.size();
    let (x0, y0) = (x.floor(), y.floor());
    let (wx, wy) = (weights(x - x0), weights(y - y0));
    let mut sum = [0.0; 3];
    for (j, wy) in wy.iter().enumerate() {
        let v = (y0 as isize + j as isize - 2).clamp(0, h as isize - 1) as usize;
        for (i, wx) in wx.iter().enumerate() {
            let u = (x0 as isize + i as isize - 2).clamp(0, w as isize - 1) as usize;
            let px = picture.at(u, v);
            for c in 0..3 {
                sum[c] += wx * wy * f64::from(px[c]);
            }
        }
    }
    sum
}

fn weights(t: f64) -> [f64; 6] {
    let sinc = |v: f64| {
        let a = std::f64::consts::PI * v;
        if a.abs() < 1e-9 { 1.0 } else { a.sin() / a }
    };
    let raw: [f64; 6] = std::array::from_fn(|k| {
        let v = t + 2.0 - k as f64;
        if v.abs() < 3.0 {
            sinc(v) * sinc(v / 3.0)
        } else {
            0.0
        }
    });
    let sum: f64 = raw.iter().sum();
    raw.map(|v| v / sum)
}

fn blurred(values: &[[f64; 3]], (w, h): (usize, usize), sigma: f64) -> Vec<[f64; 3]> {
    let reach = (4.0 * sigma).ceil() as isize;
    let kernel: Vec<f64> = (-reach..=reach)
        .map(|k| (-0.5 * (k as f64 / sigma).powi(2)).exp())
        .collect();
    let total: f64 = kernel.iter().sum();
    let along = |from: &[[f64; 3]], step: [isize; 2]| -> Vec<[f64; 3]> {
        (0..w * h)
            .map(|at| {
                let (x, y) = ((at % w) as isize, (at / w) as isize);
                let mut sum = [0.0; 3];
                for (weight, k) in kernel.iter().zip(-reach..=reach) {
                    let u = (x + k * step[0]).clamp(0, w as isize - 1) as usize;
                    let v = (y + k * step[1]).clamp(0, h as isize - 1) as usize;
                    for c in 0..3 {
                        sum[c] += weight / total * from[v * w + u][c];
                    }
                }
                sum
            })
            .collect()
    };
    along(&along(values, [1, 0]), [0, 1])
}

/// SplitMix64 with Box and Muller's normal numbers.
pub(crate) struct Random(pub(crate) u64);

impl Random {
    pub(crate) fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    pub(crate) fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.unit()).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.unit()).cos()
    }
}

/// What a planted fault makes of an alignment (offset px, roll deg, zoom %, left against right) measured without it.
pub(crate) fn expected(before: [f64; 3], plant: &Plant) -> [f64; 3] {
    let similarity = |scale: f64, clockwise_rad: f64| {
        let (sin, cos) = clockwise_rad.sin_cos();
        [[scale * cos, -scale * sin], [scale * sin, scale * cos]]
    };
    // right = M left + t, by definition of the offset at the mean position.
    let [a, roll, zoom] = before;
    let m = similarity(1.0 / (1.0 + zoom / 100.0), -roll.to_radians());
    // (I + M) l = -t with l = (0, a / 2) and r = -l.
    let t = [-(m[0][1] * a / 2.0), -(1.0 + m[1][1]) * a / 2.0];
    let p = similarity(
        1.0 + plant.larger_percent / 100.0,
        plant.clockwise_deg.to_radians(),
    );
    let times = |a: [[f64; 2]; 2], v: [f64; 2]| {
        [
            a[0][0] * v[0] + a[0][1] * v[1],
            a[1][0] * v[0] + a[1][1] * v[1],
        ]
    };
    let first = times(p, [m[0][0], m[1][0]]);
    let second = times(p, [m[0][1], m[1][1]]);
    let moved = times(p, t);
    let t = [moved[0], moved[1] + plant.down_px];
    let n = [[1.0 + first[0], second[0]], [first[1], 1.0 + second[1]]];
    let det = n[0][0] * n[1][1] - n[0][1] * n[1][0];
    let y = -(n[0][0] * t[1] - n[1][0] * t[0]) / det;
    let scale = first[0].hypot(first[1]);
    [
        2.0 * y,
        -first[1].atan2(first[0]).to_degrees(),
        100.0 * (1.0 / scale - 1.0),
    ]
}

/// A picture seen through a homography: `given_from_new` takes its pixels to those of `picture`.
pub(crate) fn mapped(picture: &Rgb, given_from_new: &nalgebra::Matrix3<f64>) -> Rgb {
    let (w, h) = picture.size();
    Rgb::from_fn(w, h, |x, y| {
        let at = given_from_new * nalgebra::Vector3::new(x as f64, y as f64, 1.0);
        sampled(picture, at.x / at.z, at.y / at.z).map(|v| v.round().clamp(0.0, 255.0) as u8)
    })
}
