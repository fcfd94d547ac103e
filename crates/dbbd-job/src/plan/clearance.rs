//! The distance of bar, tool and arm from obstacles.
//!
//! Each moving part is a capsule: a segment with a radius. The distance of a point from a convex body is a convex function of
//! the point, so that along a segment it has one minimum, which a golden-section search finds.

use nalgebra::Vector3;

use super::job::ObstacleTable;

/// A segment from one point to another, mm.
pub type LineSegment = [Vector3<f64>; 2];

/// Golden-section steps: on a segment of 2 m the minimum is known to 1e-4 mm.
const GOLDEN_SECTION_STEPS: u32 = 36;

impl ObstacleTable {
    /// Distance of a point from the obstacle, mm; 0 inside.
    pub fn from_point(&self, point: &Vector3<f64>) -> f64 {
        match *self {
            Self::Box { low_mm, high_mm } => {
                let outside = |i: usize| (low_mm[i] - point[i]).max(point[i] - high_mm[i]).max(0.0);
                Vector3::new(outside(0), outside(1), outside(2)).norm()
            }
            Self::Cylinder { from_mm, to_mm, radius_mm } => {
                let (from, to) = (Vector3::from(from_mm), Vector3::from(to_mm));
                let length = (to - from).norm();
                let along = (to - from) / length;
                let height = along.dot(&(point - from));
                let beside = (point - from - along * height).norm() - radius_mm;
                (height - length).max(-height).max(0.0).hypot(beside.max(0.0))
            }
            Self::Floor { z_mm } => (point.z - z_mm).max(0.0),
        }
    }

    /// Distance of a segment from the obstacle, mm; 0 where they meet.
    pub fn from_segment(&self, [from, to]: &LineSegment) -> f64 {
        const GOLDEN: f64 = 0.618_033_988_749_895;
        let at = |share: f64| self.from_point(&from.lerp(to, share));
        let (mut low, mut high) = (0.0, 1.0);
        let (mut left, mut right) = (1.0 - GOLDEN, GOLDEN);
        let (mut left_value, mut right_value) = (at(left), at(right));
        let mut least = at(0.0).min(at(1.0));
        for _ in 0..GOLDEN_SECTION_STEPS {
            least = least.min(left_value).min(right_value);
            if left_value <= right_value {
                (high, right, right_value) = (right, left, left_value);
                left = high - GOLDEN * (high - low);
                left_value = at(left);
            } else {
                (low, left, left_value) = (left, right, right_value);
                right = low + GOLDEN * (high - low);
                right_value = at(right);
            }
        }
        least
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn assert_near(found: f64, expected: f64) {
        assert!((found - expected).abs() < 1e-4, "{found}, not {expected}");
    }

    /// Expected distances by Pythagoras: 3-4-5 and 2-3-6-7.
    #[test]
    fn box_is_as_far_as_its_nearest_face_edge_or_corner() {
        let table = ObstacleTable::Box { low_mm: [-10.0, -20.0, 0.0], high_mm: [5.0, 7.0, 9.0] };
        for (point, distance) in [
            ([0.0, 0.0, 4.0], 0.0),
            ([6.5, 0.0, 4.0], 1.5),
            ([0.0, -22.0, 4.0], 2.0),
            ([-13.0, -24.0, 4.0], 5.0),
            ([7.0, 10.0, 15.0], 7.0),
            ([-12.0, -23.0, -6.0], 7.0),
        ] {
            assert_near(table.from_point(&point.into()), distance);
        }
    }

    #[test]
    fn cylinder_is_as_far_as_its_mantle_lid_or_rim() {
        // The axis of the cylinder is along Y and begins at 10.
        let column = ObstacleTable::Cylinder {
            from_mm: [100.0, 10.0, 0.0],
            to_mm: [100.0, 30.0, 0.0],
            radius_mm: 2.0,
        };
        for (point, distance) in [
            ([101.0, 20.0, 1.0], 0.0),
            ([100.0, 20.0, 6.0], 4.0),
            ([103.0, 15.0, 4.0], 3.0),
            ([100.0, 33.0, 1.0], 3.0),
            ([100.0, 3.0, 1.0], 7.0),
            ([105.0, 34.0, 0.0], 5.0),
            ([100.0, 6.0, 5.0], 5.0),
        ] {
            assert_near(column.from_point(&point.into()), distance);
        }
    }

    #[test]
    fn floor_is_below_a_height() {
        let floor = ObstacleTable::Floor { z_mm: -30.0 };
        assert_near(floor.from_point(&Vector3::new(7.0, 8.0, 12.0)), 42.0);
        assert_near(floor.from_point(&Vector3::new(7.0, 8.0, -31.0)), 0.0);
    }

    /// Distance of the corner (1, 1) from the line x / 12 + y / 6 = 1: |1/12 + 1/6 - 1| / sqrt(1/144 + 1/36) = 9 / sqrt 5.
    #[test]
    fn segment_is_as_far_as_its_nearest_point() {
        let cube = ObstacleTable::Box { low_mm: [-1.0; 3], high_mm: [1.0; 3] };
        let distance = |from: [f64; 3], to: [f64; 3]| cube.from_segment(&[from.into(), to.into()]);
        assert_near(distance([12.0, 0.0, 0.0], [0.0, 6.0, 0.0]), 9.0 / 5.0_f64.sqrt());
        assert_near(distance([0.0, 6.0, 0.0], [12.0, 0.0, 0.0]), 9.0 / 5.0_f64.sqrt());
        // The nearest point is at one end, at the other end, and inside.
        assert_near(distance([4.0, 0.0, 0.0], [9.0, 0.0, 0.0]), 3.0);
        assert_near(distance([0.0, 0.0, -90.0], [0.0, 0.0, -3.5]), 2.5);
        assert_near(distance([-500.0, 0.3, 0.0], [70.0, 0.3, 0.0]), 0.0);
    }
}
