//! Distances from obstacles: by hand, and the laws that every distance keeps.

use dbbd_job::plan::clearance::LineSegment;
use dbbd_job::plan::job::ObstacleTable;
use nalgebra::Vector3;
use proptest::prelude::*;

const BOX: ObstacleTable = ObstacleTable::Box { low_mm: [0.0, 0.0, 0.0], high_mm: [100.0, 200.0, 300.0] };
const COLUMN: ObstacleTable =
    ObstacleTable::Cylinder { from_mm: [0.0, 0.0, 0.0], to_mm: [0.0, 0.0, 100.0], radius_mm: 50.0 };
const FLOOR: ObstacleTable = ObstacleTable::Floor { z_mm: -10.0 };

fn segment(from: [f64; 3], to: [f64; 3]) -> LineSegment {
    [from.into(), to.into()]
}

#[test]
fn distances_by_hand() {
    for (obstacle, from, to, distance) in [
        // Beside a face, along an edge, past a corner, through.
        (&BOX, [130.0, 50.0, 50.0], [130.0, 90.0, 90.0], 30.0),
        (&BOX, [103.0, 204.0, -500.0], [103.0, 204.0, 500.0], 5.0),
        (&BOX, [101.0, 202.0, 302.0], [400.0, 500.0, 600.0], 3.0),
        (&BOX, [-50.0, 100.0, 150.0], [150.0, 100.0, 150.0], 0.0),
        // x + y = 400 over the edge (100, 200): 100 / sqrt 2.
        (&BOX, [400.0, 0.0, 150.0], [0.0, 400.0, 150.0], 100.0 / std::f64::consts::SQRT_2),
        // Beside the mantle, over the lid, past the rim (3-4-5), through.
        (&COLUMN, [80.0, -500.0, 50.0], [80.0, 500.0, 50.0], 30.0),
        (&COLUMN, [-20.0, 0.0, 140.0], [20.0, 10.0, 140.0], 40.0),
        (&COLUMN, [53.0, -900.0, 104.0], [53.0, 900.0, 104.0], 5.0),
        (&COLUMN, [0.0, 0.0, 400.0], [1.0, 1.0, -400.0], 0.0),
        (&FLOOR, [0.0, 0.0, 90.0], [500.0, 0.0, 20.0], 30.0),
        (&FLOOR, [0.0, 0.0, 90.0], [500.0, 0.0, -20.0], 0.0),
    ] {
        let found = obstacle.from_segment(&segment(from, to));
        assert!((found - distance).abs() < 1e-3, "{obstacle:?} {from:?} {to:?}: {found}, not {distance}");
    }
}

fn point() -> impl Strategy<Value = Vector3<f64>> {
    prop::array::uniform3(-600.0..600.0).prop_map(Vector3::from)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(100))]

    #[test]
    fn a_distance_is_symmetric_and_moves_no_faster_than_the_segment(
        a in point(), b in point(), shift in point(), share in 0.0..1.0,
    ) {
        for obstacle in [&BOX, &COLUMN, &FLOOR] {
            let distance = obstacle.from_segment(&[a, b]);
            prop_assert!((distance - obstacle.from_segment(&[b, a])).abs() < 1e-3);
            // Lipschitz with constant 1, and no point of the segment is nearer.
            let shift = shift * 0.1;
            let moved = obstacle.from_segment(&[a + shift, b + shift]);
            prop_assert!((moved - distance).abs() <= shift.norm() + 1e-3);
            prop_assert!(obstacle.from_point(&a.lerp(&b, share)) >= distance - 1e-3);
        }
    }
}
