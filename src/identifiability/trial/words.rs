//! A candidate in words.

use super::Kind;
use super::candidates::Candidate;

/// What is to be measured.
pub(super) fn what(candidate: &Candidate) -> String {
    let poses = candidate.poses.len();
    let place = candidate
        .ball
        .map_or_else(String::new, |ball| format!("({:.0}, {:.0}, {:.0}) mm", ball.x, ball.y, ball.z));
    match candidate.kind {
        Kind::Prior => "the same lengths with --prior datasheet".into(),
        Kind::Circle => format!("further circles about the same ball, {}, {poses} poses", candidate.detail),
        Kind::Wrist => format!("the same places with the wrist turned by 45 degrees more, {poses} poses"),
        Kind::Ball => format!("a further ball at {place}, {poses} poses"),
        Kind::TurnedBall => format!("a ball turned about axis 1 to {place}, {poses} poses"),
        Kind::Bar => format!("a bar of {} mm on the same ball, {poses} poses", candidate.detail),
    }
}
