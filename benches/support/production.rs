//! A production program whose points are corrected.

use std::fmt::Write;

use dbbd_model::robot::{Robot, inverse};

/// A production program of named points in its `.dat`, every one taught again.
pub(crate) fn production(robot: &Robot, points: usize) -> (String, String) {
    let mut source =
        "DEF P ( )\r\n$TOOL={X 0.0,Y 0.0,Z 150.0,A 0.0,B 0.0,C 0.0}\r\n$BASE=$NULLFRAME\r\n".to_owned();
    let mut data = "DEFDAT P\r\n".to_owned();
    for at in 0..points {
        // Not from zero, where an axis's turn hangs on the last digit.
        let t = (at + 1) as f64 * 1e-3;
        let deg = [
            40.0 * (0.7 * t).sin(),
            -85.0 + 15.0 * t.sin(),
            100.0 + 15.0 * (1.3 * t).cos(),
            30.0 * t.cos(),
            55.0,
            20.0,
        ];
        let axes = deg.map(f64::to_radians);
        let flange = robot.geometry.flange(&axes);
        let position = flange.position + flange.rotation.column(2) * 150.0;
        let [a, b, c] = flange.abc_deg();
        let (s, t) = (inverse::status(&robot.geometry, &axes), inverse::turn(&axes));
        let _ = write!(
            data,
            "DECL E6POS XP{at}={{X {:.3},Y {:.3},Z {:.3},A {a:.4},B {b:.4},C {c:.4},S {s},T {t},E1 0.0,E2 0.0,E3 0.0,\
             E4 0.0,E5 0.0,E6 0.0}}\r\n",
            position.x, position.y, position.z
        );
        let _ = write!(source, "{} XP{at}\r\n", if at.is_multiple_of(2) { "PTP" } else { "LIN" });
    }
    (source + "END\r\n", data + "ENDDAT\r\n")
}
