//! Seeded random numbers from integer hashes: the same on every machine, in any order, on any thread.
//!
//! No function of the maths library is used whose last bit could differ between machines; only additions, multiplications,
//! divisions and rounding.
//! multiplications, divisions and rounding are used.

use nalgebra::Vector3;

/// Scrambles 32 bits: every input bit changes about half of the output bits.
pub const fn mix(value: u32) -> u32 {
    let mut x = value;
    x ^= x >> 16;
    x = x.wrapping_mul(0x9E37_79B1);
    x ^= x >> 15;
    x = x.wrapping_mul(0x85EB_CA77);
    x ^ (x >> 13)
}

/// Hash of several numbers, depending on their order.
pub fn hash(words: &[u32]) -> u32 {
    words.iter().fold(0x2545_F491, |state, &word| extend(state, word))
}

/// Extends the hash `state` of previous numbers by one more.
fn extend(state: u32, word: u32) -> u32 {
    mix(state.rotate_left(7) ^ mix(word.wrapping_add(0x68E3_1DA4)))
}

/// A number in 0 (included) to 1 (excluded) from the upper bits of a hash.
pub fn unit(hash: u32) -> f64 {
    f64::from(hash >> 8) / f64::from(1u32 << 24)
}

/// Smooth random field over the plane or space: values at integer points, interpolated in between.
#[derive(Clone, Copy, Debug)]
pub struct ValueNoise {
    seed: u32,
}

impl ValueNoise {
    /// A field; fields of different seeds are independent.
    pub fn new(seed: u32) -> Self {
        Self { seed }
    }

    /// Value at a point of the plane, 0 to 1, with features of about one unit.
    pub fn at(&self, x: f64, y: f64) -> f64 {
        let (column, fx) = cell(x);
        let (row, fy) = cell(y);
        let corner = |dx: i32, dy: i32| self.lattice(column.wrapping_add(dx), row.wrapping_add(dy), 0);
        let upper = blend(corner(0, 0), corner(1, 0), fx);
        let lower = blend(corner(0, 1), corner(1, 1), fx);
        blend(upper, lower, fy)
    }

    /// Value at a point of space, 0 to 1.
    pub fn at_3d(&self, p: &Vector3<f64>) -> f64 {
        let (column, fx) = cell(p.x);
        let (row, fy) = cell(p.y);
        let (layer, fz) = cell(p.z);
        let slice = |dz: i32| {
            let corner = |dx, dy| self.lattice(column.wrapping_add(dx), row.wrapping_add(dy), layer.wrapping_add(dz));
            blend(blend(corner(0, 0), corner(1, 0), fx), blend(corner(0, 1), corner(1, 1), fx), fy)
        };
        blend(slice(0), slice(1), fz)
    }

    /// Sum of `octaves` fields, each twice as fine and half as strong; 0 to 1.
    pub fn fractal(&self, x: f64, y: f64, octaves: u32) -> f64 {
        self.octaves(octaves, |noise, scale| noise.at(x * scale, y * scale))
    }

    /// As [`Self::fractal`], over space.
    pub fn fractal_3d(&self, p: &Vector3<f64>, octaves: u32) -> f64 {
        self.octaves(octaves, |noise, scale| noise.at_3d(&(p * scale)))
    }

    fn octaves(&self, octaves: u32, value: impl Fn(&Self, f64) -> f64) -> f64 {
        let (mut sum, mut weights, mut weight, mut scale) = (0.0, 0.0, 1.0, 1.0);
        let seeded = hash(&[self.seed]);
        for octave in 0..octaves {
            sum += weight * value(&Self::new(extend(seeded, octave)), scale);
            weights += weight;
            weight *= 0.5;
            scale *= 2.03;
        }
        if weights > 0.0 { sum / weights } else { 0.5 }
    }

    fn lattice(&self, x: i32, y: i32, z: i32) -> f64 {
        let plane =
            mix((x as u32).wrapping_mul(0x27D4_EB2F) ^ self.seed).wrapping_add((y as u32).wrapping_mul(0x1656_67B1));
        unit(mix(plane ^ (z as u32).wrapping_mul(0x9E37_79B1)))
    }
}

/// One random point per unit cell of the plane: for spots, pebbles and patches.
#[derive(Clone, Copy, Debug)]
pub struct ScatteredPoints {
    seed: u32,
}

/// The scattered point nearest to a position.
#[derive(Clone, Copy, Debug)]
pub struct NearestPoint {
    /// Distance to it.
    pub distance: f64,
    /// Distance to the second nearest.
    pub second_distance: f64,
    /// Random number of this point.
    pub id: u32,
}

impl ScatteredPoints {
    /// A set of points; sets of different seeds are independent.
    pub fn new(seed: u32) -> Self {
        Self { seed }
    }

    /// The point nearest to `(x, y)`.
    pub fn nearest(&self, x: f64, y: f64) -> NearestPoint {
        let ((column, fx), (row, fy)) = (cell(x), cell(y));
        let mut best = NearestPoint { distance: f64::MAX, second_distance: f64::MAX, id: 0 };
        let seeded = hash(&[self.seed]);
        let columns = NEAR_FIRST.map(|dx| (dx, extend(seeded, column.wrapping_add(dx) as u32)));
        for (dy, (dx, in_column)) in NEAR_FIRST.into_iter().flat_map(|dy| columns.map(|column| (dy, column))) {
            let (across, down) = (gap(fx, dx), gap(fy, dy));
            if across * across + down * down > best.second_distance * best.second_distance {
                continue;
            }
            let id = extend(in_column, row.wrapping_add(dy) as u32);
            let px = f64::from(dx) + unit(mix(id ^ 0x51ED_270B)) - fx;
            let py = f64::from(dy) + unit(mix(id ^ 0x7F4A_7C15)) - fy;
            let distance = (px * px + py * py).sqrt();
            if distance < best.distance {
                best = NearestPoint { distance, second_distance: best.distance, id };
            } else if distance < best.second_distance {
                best.second_distance = distance;
            }
        }
        best
    }
}

/// Rises smoothly from 0 at `from` to 1 at `to`; falls if `to` is below `from`.
pub fn smooth_step(from: f64, to: f64, x: f64) -> f64 {
    let t = ((x - from) / (to - from)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// Order of neighbouring cells: the nearest points are usually in the first ones, so that most others can be skipped.
const NEAR_FIRST: [i32; 3] = [0, -1, 1];

/// Distance from a position in a cell, 0 to 1, to the cell `offset` cells away.
fn gap(place: f64, offset: i32) -> f64 {
    match offset {
        0 => 0.0,
        ..0 => place,
        _ => 1.0 - place,
    }
}

/// Integer part, rounded down, and the remainder. Without `floor`, which is a function call on processors without a native
/// instruction.
fn cell(x: f64) -> (i32, f64) {
    let toward_zero = x as i32;
    let floor = toward_zero.saturating_sub(i32::from(f64::from(toward_zero) > x));
    (floor, x - f64::from(floor))
}

fn blend(a: f64, b: f64, t: f64) -> f64 {
    a + (b - a) * (t * t * t * (t * (t * 6.0 - 15.0) + 10.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hashes_are_spread_evenly_and_depend_on_order() {
        let mut counts = [0u32; 16];
        for i in 0..16_000 {
            counts[(hash(&[7, i]) >> 28) as usize] += 1;
        }
        assert!(counts.iter().all(|&n| (850..1150).contains(&n)), "{counts:?}");
        assert_ne!(hash(&[1, 2]), hash(&[2, 1]));
        let flips: u32 = (0..3200u32).map(|i| (mix(i) ^ mix(i ^ (1 << (i % 32)))).count_ones()).sum();
        let mean_flips = f64::from(flips) / 3200.0;
        assert!((14.0..18.0).contains(&mean_flips), "{mean_flips}");
    }

    #[test]
    fn noise_is_continuous_bounded_and_seeded() {
        let noise = ValueNoise::new(3);
        let mut spread = (1.0f64, 0.0f64);
        for i in 0..4000 {
            let (x, y) = (f64::from(i) * 0.013 - 20.0, f64::from(i) * 0.007 - 9.0);
            let value = noise.fractal(x, y, 3);
            assert!((0.0..=1.0).contains(&value));
            assert!((noise.fractal(x + 1e-5, y, 3) - value).abs() < 2e-4, "jump at {x}, {y}");
            spread = (spread.0.min(value), spread.1.max(value));
        }
        assert!(spread.0 < 0.3 && spread.1 > 0.7, "{spread:?}");
        assert_ne!(noise.at(0.5, 0.5), ValueNoise::new(4).at(0.5, 0.5));
        let p = Vector3::new(-1.0 - 1e-7, 2.3, 4.1);
        assert!((noise.at_3d(&p) - noise.at_3d(&(p + Vector3::new(2e-7, 0.0, 0.0)))).abs() < 1e-4);
    }

    /// Distances of the two nearest points and number of the first, from all nine cells.
    fn by_all_cells(seed: u32, x: f64, y: f64) -> (f64, f64, u32) {
        let offsets = (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (dx, dy)));
        let mut points: Vec<_> = offsets
            .map(|(dx, dy): (i32, i32)| {
                let id = hash(&[seed, (x.floor() as i32 + dx) as u32, (y.floor() as i32 + dy) as u32]);
                let px = f64::from(dx) + unit(mix(id ^ 0x51ED_270B)) - (x - x.floor());
                let py = f64::from(dy) + unit(mix(id ^ 0x7F4A_7C15)) - (y - y.floor());
                ((px * px + py * py).sqrt(), id)
            })
            .collect();
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        (points[0].0, points[1].0, points[0].1)
    }

    #[test]
    fn nearest_point_is_found_across_cells() {
        let points = ScatteredPoints::new(11);
        for i in 0..400 {
            let (x, y) = (f64::from(i) * 0.37 - 50.0, f64::from(i) * 0.11);
            let here = points.nearest(x, y);
            assert_eq!((here.distance, here.second_distance, here.id), by_all_cells(11, x, y), "at {x}, {y}");
            assert!(here.distance <= here.second_distance);
            let beside = points.nearest(x + 1e-6, y);
            assert!((here.distance - beside.distance).abs() < 1e-5);
        }
    }
}
