//! Where a second base ball would help, found by trying: the best poses are chosen anew with each.

use nalgebra::{DMatrix, Rotation3, Vector3};

use super::Job;
use super::candidates::{Candidate, candidates, moves, rows};
use super::datasheet::{datasheet, length_sigma_mm};
use super::job::CentreTable;
use crate::identifiability::{Criterion, Exchange};
use crate::model::inverse::clearance;
use crate::model::{AXES, Robot};

/// Poses that are tried about each ball.
const CANDIDATES: usize = 300;
/// Places that are tried: how far out (mm), up (mm) and about axis 1 (degrees) from the ball that there is.
const PLACES: [([f64; 3], &str); 6] = [
    ([0.0, 0.0, 60.0], "turned about axis 1 alone"),
    ([-350.0, 0.0, 60.0], "nearer to axis 1"),
    ([0.0, -400.0, 60.0], "lower"),
    ([0.0, 400.0, 60.0], "higher"),
    ([-350.0, -400.0, 60.0], "nearer and lower"),
    ([-350.0, 400.0, 60.0], "nearer and higher"),
];
/// A second ball helps when it leaves less than this share of the error.
const HELPS: f64 = 0.85;

/// What a second ball at some places would do, in words; `None` for a job with several balls, or where nothing can be
/// chosen. `poses` are the axis vectors (rad) of the workspace.
pub(crate) fn second_ball(job: &Job, robot: &Robot, count: usize, poses: &[[f64; AXES]]) -> Option<String> {
    let [ball] = job.centres.as_slice() else { return None };
    let first = Vector3::from(ball.xyz_mm);
    let mut two = job.clone();
    two.centres.push(CentreTable { id: 2, taught_deg: None, ..ball.clone() });
    let pool = reached(job, robot, 1, first);
    let alone = left(&two, robot, &pool, count, poses)?;
    let tried: Vec<(f64, Vector3<f64>, &str)> = PLACES
        .iter()
        .filter_map(|([out, up, turn], words)| {
            let radius = first.xy().norm();
            let place = Vector3::new(
                first.x * (radius + out) / radius.max(1.0),
                first.y * (radius + out) / radius.max(1.0),
                first.z + up,
            );
            let place = Rotation3::from_axis_angle(&Vector3::z_axis(), turn.to_radians()) * place;
            two.centres.last_mut()?.xyz_mm = place.into();
            let both: Vec<Candidate> = pool.iter().cloned().chain(reached(job, robot, 2, place)).collect();
            Some((left(&two, robot, &both, count, poses)? / alone, place, *words))
        })
        .collect();
    let turned = tried.first().map_or(1.0, |(share, ..)| *share);
    let (share, place, words) = tried.into_iter().min_by(|a, b| a.0.total_cmp(&b.0))?;
    let same = format!("one turned about axis 1 alone leaves {:.0} % of the error", 100.0 * turned.min(1.0));
    Some(if share < HELPS {
        format!(
            "a second base ball {words}, near ({:.0}, {:.0}, {:.0}) mm, would leave {:.0} % of the 3-D error of as many poses \
             chosen freely about this one ({alone:.3} mm); {same}",
            place.x,
            place.y,
            place.z,
            100.0 * share
        )
    } else {
        format!(
            "no second base ball of {} places tried would leave less than {:.0} % of the 3-D error of as many poses chosen \
             freely about this one ({alone:.3} mm); {same}",
            PLACES.len(),
            100.0 * HELPS
        )
    })
}

/// Poses about a ball within limits and off the singularities; what stands in the way there is not known.
fn reached(job: &Job, robot: &Robot, number: u32, ball: Vector3<f64>) -> Vec<Candidate> {
    let limits = &job.limits;
    let (arm, seed) = (&robot.geometry, u64::from(job.seed));
    candidates(arm, &robot.limits_deg, (number, ball), job.bar.length_mm, None, CANDIDATES, seed, |axes| {
        clearance(arm, axes).is_none_or(|clear| {
            clear.wrist.to_degrees() > limits.min_a5_deg
                && clear.elbow.to_degrees() > limits.min_elbow_deg
                && clear.overhead > limits.min_overhead_mm
        })
    })
}

/// Root mean square 3-D error that the best `count` of the poses leave, mm.
fn left(job: &Job, robot: &Robot, pool: &[Candidate], count: usize, poses: &[[f64; AXES]]) -> Option<f64> {
    if pool.len() < count {
        return None;
    }
    let belief = datasheet(job, robot);
    let columns: DMatrix<f64> = rows(&belief, pool, length_sigma_mm(job, robot));
    let moved = moves(&belief, poses);
    let mut exchange = Exchange::new(&columns, &moved);
    exchange.extend(count, Criterion::D);
    exchange.improve(Criterion::D);
    exchange.improve(Criterion::I);
    Some(exchange.rms_error_mm()).filter(|error| error.is_finite())
}
