//! Decides at which pose of the plan the robot was in each of its rests.
//!
//! A hidden Markov model over the rests in order of time; its state is the next pose. A program proceeds from pose
//! to pose. It can rest twice at one pose, leave a pose without a rest (mostly where packets are missing), restart
//! a module, or rest where no pose is commanded, as at the HALT at the start of a module. Forward and backward
//! sums give the posterior of each pair.

use super::program::CommandedDwell;

/// Probability of another rest at the same pose: a HALT, a push by hand, missing packets.
const AGAIN: f64 = 0.1;
/// Probability that a pose left no rest, and the same probability if packets are missing.
const PASSED: f64 = 1e-4;
const PASSED_UNSEEN: f64 = 0.8;
/// Probability that a rest at the position of a pose is no visit of this pose, and the same probability at the start of
/// a module.
const OTHER: f64 = 1e-6;
const HALT: f64 = 3e-3;
/// Probability that a module restarts before a rest. Less than [`OTHER`]: a single rest at its start proves nothing.
const RESTARTED: f64 = 1e-8;
/// Probability that the program continues anywhere else.
const ELSEWHERE: f64 = 1e-11;

/// A rest as the model sees it.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct RestEvidence {
    /// The poses at this position.
    pub(super) poses: Vec<usize>,
    /// Whether packets are missing since the rest before.
    pub(super) after_loss: bool,
}

/// A rest and the probability that it belongs to the pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct PoseVisit {
    pub(super) rest: usize,
    pub(super) posterior: f64,
}

/// The rests at the position of each pose, in order of time.
pub(super) fn visits(seen: &[RestEvidence], poses: &[CommandedDwell]) -> Vec<Vec<PoseVisit>> {
    let chain = VisitWeights::new(poses);
    // The states before the first rest and after the last one are unknown.
    let mut next = vec![1.0; chain.other.len()];
    let mut before = Vec::with_capacity(seen.len());
    for (at, rest) in seen.iter().enumerate() {
        if at > 0 {
            chain.forward_between_rests(&mut next, rest.after_loss);
        }
        before.push(next.clone());
        next = chain.forward_over_rest(rest, &next);
        normalise(&mut next);
    }
    let mut visits = vec![Vec::new(); poses.len()];
    let mut later = vec![1.0; chain.other.len()];
    for (at, (rest, before)) in seen.iter().zip(&before).enumerate().rev() {
        let since = chain.backward_over_rest(rest, &later);
        let total: f64 = before.iter().zip(&since).map(|(before, since)| before * since).sum();
        for pose in &rest.poses {
            let posterior = (before[*pose] + AGAIN * before[pose + 1]) * later[pose + 1] / total;
            visits[*pose].push(PoseVisit { rest: at, posterior });
        }
        later = since;
        chain.backward_between_rests(&mut later, rest.after_loss);
        normalise(&mut later);
    }
    visits.iter_mut().for_each(|visits| visits.reverse());
    visits
}

fn normalise(weights: &mut [f64]) {
    let total: f64 = weights.iter().sum();
    weights.iter_mut().for_each(|weight| *weight /= total);
}

/// Weights of the events at a rest and between two rests.
struct VisitWeights {
    /// Weight of a rest that is no visit, by the next pose; the last entry is for the end, after which there is no
    /// pose.
    other: Vec<f64>,
    /// The first pose of each module.
    begins: Vec<usize>,
}

impl VisitWeights {
    fn new(poses: &[CommandedDwell]) -> Self {
        let begins = |pose: &usize| *pose == 0 || poses[*pose].module != poses[pose - 1].module;
        let begins: Vec<usize> = (0..poses.len()).filter(begins).collect();
        let mut other = vec![OTHER; poses.len() + 1];
        begins.iter().for_each(|begin| other[*begin] = HALT);
        Self { other, begins }
    }

    /// Forward step over a rest: weights of the next pose.
    fn forward_over_rest(&self, rest: &RestEvidence, before: &[f64]) -> Vec<f64> {
        let mut after: Vec<f64> =
            before.iter().zip(&self.other).map(|(weight, other)| other * weight).collect();
        for pose in &rest.poses {
            after[pose + 1] += before[*pose] + AGAIN * before[pose + 1];
        }
        after
    }

    /// Backward step over a rest.
    fn backward_over_rest(&self, rest: &RestEvidence, later: &[f64]) -> Vec<f64> {
        let mut since: Vec<f64> =
            later.iter().zip(&self.other).map(|(weight, other)| other * weight).collect();
        for pose in &rest.poses {
            since[*pose] += later[pose + 1];
            since[pose + 1] += AGAIN * later[pose + 1];
        }
        since
    }

    fn passed(after_loss: bool) -> f64 {
        if after_loss { PASSED_UNSEEN } else { PASSED }
    }

    fn forward_between_rests(&self, next: &mut [f64], after_loss: bool) {
        let total: f64 = next.iter().sum();
        let elsewhere = ELSEWHERE / next.len() as f64 * total;
        next.iter_mut().for_each(|weight| *weight += elsewhere);
        self.begins.iter().for_each(|begin| next[*begin] += RESTARTED * total);
        for at in 1..next.len() {
            next[at] += Self::passed(after_loss) * next[at - 1];
        }
    }

    /// Backward step between two rests.
    fn backward_between_rests(&self, later: &mut [f64], after_loss: bool) {
        for at in (1..later.len()).rev() {
            later[at - 1] += Self::passed(after_loss) * later[at];
        }
        let elsewhere = ELSEWHERE / later.len() as f64 * later.iter().sum::<f64>();
        let restarted = RESTARTED * self.begins.iter().map(|begin| later[*begin]).sum::<f64>();
        later.iter_mut().for_each(|weight| *weight += elsewhere + restarted);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn poses(modules: &[usize]) -> Vec<CommandedDwell> {
        modules.iter().map(|module| CommandedDwell { move_s: 1.0, wait_s: 1.0, module: *module }).collect()
    }

    fn seen(places: &[&[usize]]) -> Vec<RestEvidence> {
        places.iter().map(|poses| RestEvidence { poses: poses.to_vec(), after_loss: false }).collect()
    }

    /// Posteriors of each pose with the index of the rest.
    fn posteriors(seen: &[RestEvidence], modules: &[usize]) -> Vec<Vec<(usize, f64)>> {
        let pairs = |of: &Vec<PoseVisit>| of.iter().map(|visit| (visit.rest, visit.posterior)).collect();
        visits(seen, &poses(modules)).iter().map(pairs).collect()
    }

    /// Before the rest each of the states is as likely: the pose comes next, or it was just visited. Weights of
    /// the rest: its visit 1, a HALT before it 0.003; another rest there 0.1, no visit after it 1e-6.
    #[test]
    fn posterior_of_one_rest_at_one_pose() {
        let found = posteriors(&seen(&[&[0]]), &[0]);
        assert_eq!(found[0][0].0, 0);
        assert!((found[0][0].1 - 1.1 / (1.1 + 0.003 + 1e-6)).abs() < 1e-12);
        assert_eq!(posteriors(&seen(&[&[]]), &[0]), [vec![]]);
    }

    /// Two poses at one place, and two rests there. Without what is rare the rests are 0 and 1 from two states (1
    /// and 0.1), 0 twice (0.1 and 0.01) or 1 twice (0.1 and 0.01): in 1.21 of 1.32 the first is of pose 0, and so
    /// the second of pose 1.
    #[test]
    fn order_distinguishes_equal_positions() {
        let found = posteriors(&seen(&[&[0, 1], &[0, 1]]), &[0, 0]);
        let of = |pose: usize, rest: usize| found[pose].iter().find(|pair| pair.0 == rest).unwrap().1;
        for (pose, rest, share) in
            [(0, 0, 1.21 / 1.32), (1, 0, 0.11 / 1.32), (0, 1, 0.11 / 1.32), (1, 1, 1.21 / 1.32)]
        {
            assert!((of(pose, rest) - share).abs() < 5e-3, "pose {pose}, rest {rest}: {}", of(pose, rest));
        }
    }

    /// Poses 0 and 2 are at one place, pose 1 at another, and two rests at the first place. They are of pose 0
    /// (0.1 + 0.01, as above), of pose 2 (0.11), or of 0 and 2 with pose 1 passed: 1.1 times 1e-4, or times 0.8
    /// where packets are missing.
    #[test]
    fn pose_is_skipped_where_packets_are_missing() {
        for (after_loss, share) in [(false, 0.11 / 0.22), (true, (0.11 + 0.88) / 1.1)] {
            let mut rests = seen(&[&[0, 2], &[0, 2]]);
            rests[1].after_loss = after_loss;
            let found = posteriors(&rests, &[0, 0, 0]);
            let of = |pose: usize| found[pose].iter().find(|pair| pair.0 == 1).unwrap().1;
            assert!((of(2) - share).abs() < 0.01 && (of(0) - (1.0 - share)).abs() < 0.01, "{after_loss}");
        }
    }

    /// A module of four poses is run twice. That it was started again weighs 1e-8, that the first four rests were
    /// HALTs 0.003^4 = 8.1e-11.
    #[test]
    fn module_is_restarted() {
        let found = posteriors(&seen(&[&[0], &[1], &[2], &[3], &[0], &[1], &[2], &[3]]), &[0; 4]);
        for (pose, of_pose) in found.iter().enumerate() {
            assert_eq!(of_pose.iter().map(|pair| pair.0).collect::<Vec<_>>(), [pose, pose + 4]);
            assert!(of_pose.iter().all(|(_, share)| *share > 0.98), "{of_pose:?}");
        }
    }
}
