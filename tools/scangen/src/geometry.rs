//! Small vector arithmetic, boxes and placements. Everything is `f64`, in metres unless said otherwise.
//!
//! Only correctly rounded operations (`+ - * / sqrt`) and the portable `libm` are used, so that a seed gives the same
//! points on every platform.

/// A point or vector: x, y, z.
pub type Vec3 = [f64; 3];

/// `a + b`.
#[inline]
pub fn add(a: Vec3, b: Vec3) -> Vec3 {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

/// `a - b`.
#[inline]
pub fn sub(a: Vec3, b: Vec3) -> Vec3 {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// `a · k`.
#[inline]
pub fn scale(a: Vec3, k: f64) -> Vec3 {
    [a[0] * k, a[1] * k, a[2] * k]
}

/// Scalar product.
#[inline]
pub fn dot(a: Vec3, b: Vec3) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Vector product.
#[inline]
pub fn cross(a: Vec3, b: Vec3) -> Vec3 {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// Euclidean length.
#[inline]
pub fn length(a: Vec3) -> f64 {
    dot(a, a).sqrt()
}

/// `a` scaled to length 1; the zero vector stays unchanged.
#[inline]
pub fn unit(a: Vec3) -> Vec3 {
    let len = length(a);
    if len > 0.0 { scale(a, 1.0 / len) } else { a }
}

/// Sine and cosine of an angle in degrees; exact at multiples of 90°, so that lattice-aligned scenes stay aligned.
pub fn sin_cos_deg(deg: f64) -> (f64, f64) {
    let quarter = deg / 90.0;
    if quarter == quarter.floor() {
        return match quarter.rem_euclid(4.0) as i32 {
            0 => (0.0, 1.0),
            1 => (1.0, 0.0),
            2 => (0.0, -1.0),
            _ => (-1.0, 0.0),
        };
    }
    libm::sincos(deg.to_radians())
}

/// A closed axis-aligned box.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Aabb {
    /// Least corner.
    pub min: Vec3,
    /// Greatest corner.
    pub max: Vec3,
}

impl Aabb {
    /// The empty box; extending it by a point gives that point.
    pub const EMPTY: Self = Self { min: [f64::INFINITY; 3], max: [f64::NEG_INFINITY; 3] };

    /// The box with these corners.
    pub fn new(min: Vec3, max: Vec3) -> Self {
        Self { min, max }
    }

    /// The smallest box around these points.
    pub fn around(points: impl IntoIterator<Item = Vec3>) -> Self {
        points.into_iter().fold(Self::EMPTY, |mut b, p| {
            b.grow(p);
            b
        })
    }

    /// Extends the box to contain `p`.
    #[inline]
    pub fn grow(&mut self, p: Vec3) {
        for (axis, value) in p.into_iter().enumerate() {
            self.min[axis] = self.min[axis].min(value);
            self.max[axis] = self.max[axis].max(value);
        }
    }

    /// The smallest box that contains both.
    pub fn union(&self, other: &Self) -> Self {
        let mut both = *self;
        for axis in 0..3 {
            both.min[axis] = both.min[axis].min(other.min[axis]);
            both.max[axis] = both.max[axis].max(other.max[axis]);
        }
        both
    }

    /// Returns whether `p` is in the closed box.
    #[inline]
    pub fn contains(&self, p: Vec3) -> bool {
        (0..3).all(|a| self.min[a] <= p[a] && p[a] <= self.max[a])
    }

    /// Centre.
    pub fn center(&self) -> Vec3 {
        scale(add(self.min, self.max), 0.5)
    }

    /// Squared distance between two closed boxes; 0 if they meet.
    #[inline]
    pub fn distance_squared(&self, other: &Self) -> f64 {
        (0..3).map(|a| interval_gap(self.min[a], self.max[a], other.min[a], other.max[a])).map(|g| g * g).sum()
    }

    /// Squared distance from a point to the closed box; 0 inside.
    #[inline]
    pub fn point_distance_squared(&self, p: Vec3) -> f64 {
        (0..3).map(|a| interval_gap(self.min[a], self.max[a], p[a], p[a])).map(|g| g * g).sum()
    }

    /// The eight corners; bit `a` of the index chooses the greater side on axis `a`.
    pub fn corners(&self) -> [Vec3; 8] {
        std::array::from_fn(|i| std::array::from_fn(|a| if i >> a & 1 == 1 { self.max[a] } else { self.min[a] }))
    }

    /// The part `[t0, t1]` of the segment `origin + t·dir`, `t ∈ [t_min, t_max]`, that is inside the closed box.
    #[inline]
    pub fn clip(&self, origin: Vec3, dir: Vec3, t_min: f64, t_max: f64) -> Option<(f64, f64)> {
        let (mut t0, mut t1) = (t_min, t_max);
        for a in 0..3 {
            if dir[a] == 0.0 {
                if origin[a] < self.min[a] || origin[a] > self.max[a] {
                    return None;
                }
                continue;
            }
            let inverse = 1.0 / dir[a];
            let (near, far) = ((self.min[a] - origin[a]) * inverse, (self.max[a] - origin[a]) * inverse);
            t0 = t0.max(near.min(far));
            t1 = t1.min(near.max(far));
        }
        (t0 <= t1).then_some((t0, t1))
    }
}

/// Gap between two closed intervals; 0 if they meet.
#[inline]
pub fn interval_gap(a0: f64, a1: f64, b0: f64, b1: f64) -> f64 {
    (b0 - a1).max(a0 - b1).max(0.0)
}

/// Placement of a scene in the world: rotation about the vertical axis, then a shift.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Placement {
    /// Anticlockwise rotation about the z axis through the scene's origin `[°]`.
    pub rotate_deg: f64,
    /// Shift after the rotation (m).
    pub translate: Vec3,
}

impl Placement {
    /// Leaves everything in place.
    pub const IDENTITY: Self = Self { rotate_deg: 0.0, translate: [0.0; 3] };

    /// The image of a point.
    pub fn apply(&self, p: Vec3) -> Vec3 {
        add(self.turn(p), self.translate)
    }

    /// The image of a direction.
    pub fn turn(&self, p: Vec3) -> Vec3 {
        let (s, c) = sin_cos_deg(self.rotate_deg);
        [p[0] * c - p[1] * s, p[0] * s + p[1] * c, p[2]]
    }
}

impl Default for Placement {
    fn default() -> Self {
        Self::IDENTITY
    }
}
