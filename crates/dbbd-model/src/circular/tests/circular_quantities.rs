//! The quantities of the circular test against an independent fit and linear programme.

use dbbd_model::base::expansion::ThermalExpansion;
use dbbd_model::circular::{CircleSense, CircleTrace, CircularSettings, DriveId, circular, traces_from_csv};
use dbbd_model::diagnostic::Finding;

use crate::test_support::circular_cases::{CASES, Case, GOLDEN, exactly, trace};

#[test]
fn quantities_match_an_independent_computation() {
    let mut worst = 0.0_f64;
    let mut compared = 0;
    for case in CASES {
        let found = exactly(&case.traces(), case.radius);
        for (_, name, golden) in GOLDEN.iter().filter(|(of, _, _)| *of == case.name) {
            let value = match name.split_once(' ') {
                Some((term, sense)) => {
                    let harmonics =
                        found.diagnosis.harmonics.iter().find(|found| found.sense.word() == sense).unwrap();
                    harmonics.values_mm[if term == "c2" { 3 } else { 4 }]
                }
                None => found.get(name).value.unwrap(),
            };
            worst = worst.max((value - golden).abs());
            compared += 1;
            assert!((value - golden).abs() < 1e-9, "{} {name}: {value} against {golden}", case.name);
        }
    }
    assert_eq!(compared, GOLDEN.len());
    eprintln!("{compared} values, worst difference {worst:e} mm");
}

#[test]
fn exact_circle_has_no_deviation() {
    // Linear removal of the centre would leave e^2 / (2 R) = 3.3 um.
    let case = CASES[0];
    let length = |angle: f64| {
        let theta = angle.to_radians();
        (150.0 * theta.cos() - 1.0).hypot(150.0 * theta.sin()) + 0.01
    };
    let traces =
        [trace("1", CircleSense::CounterClockwise, case.angles().into_iter().map(|a| (a, length(a))))];
    let found = exactly(&traces, 150.0);
    for (name, expected) in
        [("G_lsc", 0.0), ("G_mzc", 0.0), ("D", 0.01), ("F_max", 0.01), ("x", 1.0), ("y", 0.0)]
    {
        let value = found.get(name).value.unwrap();
        assert!((value - expected).abs() < 1e-11, "{name}: {value}");
    }
    assert_eq!((found.get("Gb").value, found.get("H").value), (None, None), "one sense has neither");
}

#[test]
fn squareness_mismatch_and_hysteresis_are_recovered() {
    // First order in the errors; the second order of 1e-4 is 1e-8 of the radius.
    let case = Case { backlash: [0.0; 2], centre: [0.0; 2], ..CASES[0] };
    let found = exactly(&case.traces(), case.radius);
    let [mismatch, _] = found.diagnosis.scale_mismatch.unwrap();
    let [squareness, _] = found.diagnosis.squareness_rad.unwrap();
    assert!((mismatch - 65e-6).abs() < 2e-8, "{mismatch}");
    assert!((squareness - 60e-6).abs() < 2e-8, "{squareness}");
    assert!(found.get("H").value.unwrap() < 1e-12, "both senses are alike");
    // Backlash of one axis opens the senses by b |cos|: exactly b where the axis alone points outward.
    let found = exactly(&Case { backlash: [0.0, 0.006], ..case }.traces(), case.radius);
    assert!((found.get("H").value.unwrap() - 0.006).abs() < 1e-5);
}

#[test]
fn short_arcs_have_no_free_centre() {
    for (span, told) in [(360.0, true), (180.0, true), (90.0, true), (60.0, false), (20.0, false)] {
        let case = Case { span, points: 60, ..CASES[1] };
        let found = exactly(&case.traces(), case.radius);
        assert_eq!(found.get("G_lsc").value.is_some(), told, "{span} degrees, {:?}", found.arc);
        assert_eq!(found.get("x").value.is_some(), told);
        assert_eq!(found.free_centre, span == 360.0);
        // F about the instrument's centre needs no fit.
        let deviations = case.traces()[0].points.iter().map(|p| p.length_mm - 300.0).collect::<Vec<_>>();
        if span < 360.0 {
            let most = deviations.iter().copied().fold(f64::MIN, f64::max);
            assert!((found.get("F_max").value.unwrap() - most).abs() < 1e-9);
            assert!(found.notes[0].code().as_str() == "I1410", "{:?}", found.notes);
            assert!((found.arc.span_deg - span).abs() < 1e-6 && (found.arc.from_deg - 20.0).abs() < 1e-6);
        }
    }
}

#[test]
fn lengths_are_referred_to_twenty_degrees() {
    let case = Case { both: false, ..CASES[0] };
    let mut traces = case.traces();
    let cold = exactly(&traces, case.radius);
    let (bar, machine) = (1.2e-6, 11.7e-6);
    for point in traces.iter_mut().flat_map(|trace| &mut trace.points) {
        // The machine grew, and the bar's length is taken too short by its own growth.
        point.length_mm *= (1.0 + machine * 5.0) / (1.0 + bar * 3.0);
        point.temp_c = Some(25.0);
    }
    let temperature =
        ThermalExpansion { bar_per_k: Some(bar), certified_c: 22.0, machine_per_k: Some(machine) };
    let settings = CircularSettings { draws: 0, temperature, ..CircularSettings::new(case.radius) };
    let found = circular(&traces, &settings).unwrap();
    for name in ["G_lsc", "D", "F_max", "x"] {
        assert!((found.get(name).value.unwrap() - cold.get(name).value.unwrap()).abs() < 1e-9, "{name}");
    }
    let raw = found.as_measured.unwrap()[3].unwrap();
    assert!((raw - cold.get("D").value.unwrap() - 150.0 * (5.0 * machine - 3.0 * bar)).abs() < 1e-5, "{raw}");
}

#[test]
fn csv_errors_have_line_and_column() {
    let head = "run,direction,angle_deg,length_mm\n";
    for (text, says) in [
        ("run,angle_deg,length_mm\n1,0,150\n".to_owned(), "E0110"),
        (head.to_owned(), "E1401"),
        (format!("{head}1,ccw,0,150\n1,left,5,150\n"), "E1404"),
        (format!("{head}1,ccw,0,abc\n"), "E0111"),
        (format!("{head}1,ccw,inf,150\n"), "E0111"),
        (format!("{head}1,ccw,0,-150\n"), "length_mm"),
        (format!("{head}1,ccw,0\n"), "E0112"),
        (format!("{head}1,ccw,0,150000\n"), "E0130"),
        ("run,direction,angle_deg,length_mm,temp_c\n1,ccw,0,150,293.15\n".to_owned(), "E0130"),
    ] {
        let wrong = traces_from_csv("bad.csv", &text).unwrap_err();
        assert!(wrong.code().as_str() == says || wrong.message().contains(says), "{says}: {wrong}");
    }
    let few = traces_from_csv("few.csv", &format!("{head}1,cw,0,150\n1,cw,9,150\n")).unwrap();
    let refused = |traces: &[CircleTrace], radius| {
        circular(traces, &CircularSettings::new(radius)).unwrap_err().code().as_str()
    };
    assert_eq!(refused(&few, 150.0), "E1401");
    let same = [trace("1", CircleSense::Clockwise, (0..9).map(|_| (7.0, 150.0)))];
    assert_eq!(refused(&same, 150.0), "E1403", "one direction is no circle");
    assert_eq!(refused(&same, 100.0), "E1402");
    assert_eq!(refused(&same, f64::NAN), "E1402");
    let mut backwards = CASES[0].traces();
    backwards.truncate(1);
    backwards[0].sense = CircleSense::Clockwise;
    let found = circular(&backwards, &CircularSettings::new(CASES[0].radius)).unwrap();
    let notes: Vec<&str> = found.notes.iter().map(|note| note.code().as_str()).collect();
    assert_eq!(notes, ["I1411", "I1412"]);
}

#[test]
fn reversal_steps_are_fitted() {
    for case in [CASES[0], CASES[2]] {
        let found = exactly(&case.traces(), case.radius);
        assert_eq!(found.steps.len(), 2);
        for (at, (step, backlash)) in found.steps.iter().zip(case.backlash).enumerate() {
            assert_eq!(step.mover, DriveId::Axis(at + 1));
            // The case's axes run ahead by half of it in their sense of motion.
            let off = (step.play + backlash).abs();
            assert!(off < 2e-4 && off <= step.u95, "{}: {step:?}, {backlash}", case.name);
            // A point stands within 0.09 degrees of where the lever is 1.
            assert!((step.most_mm - step.play.abs()).abs() < 1e-6);
        }
    }
    // Half a circle does not determine the backlash.
    assert!(exactly(&CASES[1].traces(), CASES[1].radius).steps.is_empty());
}
