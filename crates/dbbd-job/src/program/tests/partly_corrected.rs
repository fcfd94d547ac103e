//! Programs as generators and people write them: what can be corrected is corrected, and each other motion stays and is named.
//!
//! The situations are those of public threads and of programs of RoboDK's posts: FDAT_ACT as an aggregate, points that are computed,
//! the geometric operator, configurations and external axes of variables, options of FANUC's motions.

use crate::program::script::points::Points;
use dbbd_job::program::krl::{self, Files, Given};
use dbbd_job::program::{Text, fanuc, rapid};
use dbbd_model::diagnostic::Diagnostic;

const DATA: &str = "DEFDAT P\nDECL E6POS XP1={X 1300.0,Y 0.0,Z 1000.0,A 0.0,B 120.0,C 0.0,S 2,T 2}\nENDDAT\n";
const TOOL: &str = "$TOOL={X 0.0,Y 0.0,Z 120.0,A 0.0,B 0.0,C 0.0}";
const START: &str = "PTP {A1 0.0,A2 -90.0,A3 90.0,A4 0.0,A5 30.0,A6 0.0}";
const POSE: &str = "{X 1300.0,Y 0.0,Z 1000.0,A 0.0,B 120.0,C 0.0}";

/// What is corrected, by the lines of the first uses, and what stays, by code and line; or the refusal.
type Answer = Result<(Vec<usize>, Vec<String>), String>;

fn code(finding: &Diagnostic) -> String {
    format!("{} {}", finding.code(), finding.line_number())
}

fn krl(body: &str) -> Answer {
    let source = format!("DEF P()\n{}\nEND\n", body.replace('|', "\n"));
    let source = Text { file: "P.src", text: &source };
    let files = Files { source, data: Some(Text { file: "P.dat", text: DATA }), config: None };
    let read = krl::read(files, Given::default()).map_err(|why| code(&why))?;
    let lines = read.points.iter().map(|point| source.line(point.first_use.start)).collect();
    Ok((lines, read.not_corrected.iter().chain(&read.warnings).map(code).collect()))
}

fn points(read: Result<Points, Diagnostic>, text: Text<'_>) -> Answer {
    let read = read.map_err(|why| code(&why))?;
    let lines = read.points.iter().map(|point| text.line(point.first_use.start)).collect();
    Ok((lines, read.not_corrected.iter().chain(&read.warnings).map(code).collect()))
}

fn rapid(data: &str, body: &str) -> Answer {
    let text = format!("MODULE M\n{}\nPROC main()\n{}\nENDPROC\nENDMODULE\n", data, body.replace('|', "\n"));
    let text = Text { file: "M.mod", text: &text };
    points(rapid::read(text, None), text)
}

fn fanuc(lines: &str) -> Answer {
    let position = |number: usize, x: f64| {
        format!(
            "P[{number}]{{\n   GP1:\n\tUF : 0, UT : 0,\tCONFIG : 'N U T, 0, 0, 0',\n\tX = {x:.3} mm,\tY = 100.000 mm,\tZ = 300.000 mm,\n\tW = 180.000 deg,\tP = -30.000 deg,\tR = 0.000 deg\n}};\n"
        )
    };
    let head = "/PROG  P\n/MN\n   1:  UFRAME_NUM=0 ;\n   2:  UTOOL_NUM=0 ;\n";
    let text = format!(
        "{head}{}\n/POS\n{}{}/END\n",
        lines.replace('|', "\n"),
        position(1, 1000.0),
        position(2, 900.0)
    );
    let text = Text { file: "P.LS", text: &text };
    points(fanuc::read(text, fanuc::GivenFrames::default()), text)
}

fn corrected(lines: &[usize], left: &[&str]) -> Answer {
    Ok((lines.to_vec(), left.iter().map(|left| (*left).to_owned()).collect()))
}

#[test]
fn computed_points_of_krl_stay_and_the_rest_is_corrected() {
    let frames = format!("{TOOL}|$BASE=$NULLFRAME|{START}");
    for (body, expected) in [
        // A point that is derived from a corrected one.
        (format!("{frames}|XAPP=XP1|XAPP.Z=XAPP.Z+100.0|LIN XAPP|LIN XP1"), corrected(&[4, 8], &["W0905 7"])),
        // The geometric operator, a partial point, a function.
        (format!("{frames}|LIN XP1:{{Z 100}}|LIN XP1"), corrected(&[4, 6], &["W0905 5"])),
        (format!("{frames}|LIN {{Z 500}}|LIN XP1"), corrected(&[4, 6], &["W0905 5"])),
        (format!("{frames}|LIN F(1)|LIN XP1"), corrected(&[4, 6], &["W0905 5"])),
        // One point under two bases stays in both places.
        (
            format!("{frames}|LIN {POSE}|LIN XP1|$BASE={{X 10,Y 0,Z 0,A 0,B 0,C 0}}|LIN XP1"),
            corrected(&[4, 5], &["W0905 8", "W0905 6"]),
        ),
        // A base that is not known, after one that is; the point of both stays.
        (
            format!("{frames}|LIN XP1|$BASE=F(1)|LIN XP1|LIN {POSE}"),
            corrected(&[4], &["W0905 7", "W0905 8", "W0905 5"]),
        ),
        (format!("{frames}|LIN {POSE}|$BASE=F(1)|LIN XP1"), corrected(&[4, 5], &["W0905 7"])),
        // Axis angles need no frames, but of these poses none is right.
        (format!("{START}|LIN {POSE}"), Err("E0901 3".into())),
    ] {
        assert_eq!(krl(&body), expected, "{body}");
    }
}

#[test]
fn frame_data_are_read_as_generators_write_them() {
    let base = "$BASE={FRAME: X 10.0,Y 0.0,Z 0.0,A 0.0,B 0.0,C 0.0}";
    let all = corrected(&[5, 6], &[]);
    for (body, expected) in [
        (
            format!("FDAT_ACT={{TOOL_NO 0,BASE_NO 0,IPO_FRAME #BASE}}|BAS(#FRAMES)|;|{START}|LIN {POSE}"),
            all.clone(),
        ),
        (format!("FDAT_ACT.TOOL_NO=0|FDAT_ACT.BASE_NO=0|BAS(#FRAMES)|{START}|LIN {POSE}"), all.clone()),
        (
            format!("FDAT_ACT={{TOOL_NO N,BASE_NO 0,IPO_FRAME #BASE}}|{TOOL}|{base}|{START}|LIN {POSE}"),
            all.clone(),
        ),
        // The tool is not known, is in no file given, or is fixed in the cell.
        (format!("FDAT_ACT.BASE_NO=0|BAS(#FRAMES)|;|{START}|LIN {POSE}"), Err("E0901 6".into())),
        (
            format!("FDAT_ACT.TOOL_NO=3|FDAT_ACT.BASE_NO=0|BAS(#FRAMES)|{START}|LIN {POSE}"),
            Err("E0901 6".into()),
        ),
        (
            format!("FDAT_ACT={{TOOL_NO 0,BASE_NO 0,IPO_FRAME #TCP}}|BAS(#FRAMES)|;|{START}|LIN {POSE}"),
            corrected(&[5], &["W0905 6"]),
        ),
        // A tool that is fixed in the cell remains so through what cannot be read.
        (format!("$IPO_MODE=#TCP|BAS(N,1)|{TOOL}|{base}|{START}|LIN {POSE}"), corrected(&[6], &["W0905 7"])),
        // What cannot be read leaves the frames unknown.
        (format!("{TOOL}|{base}|BAS(|{START}|LIN {POSE}"), corrected(&[5], &["W0905 6"])),
    ] {
        assert_eq!(krl(&body), expected, "{body}");
    }
}

/// Bit 4 of S: 18 is 2 with it.
#[test]
fn points_taught_under_absolute_accuracy_are_named() {
    let frames = format!("{TOOL}|$BASE=$NULLFRAME|{START}");
    let point =
        |status: u8| format!("{frames}|PTP {{X 1300.0,Y 10.0,Z 1000.0,A 0.0,B 120.0,C 0.0,S {status},T 3}}");
    assert_eq!(krl(&point(2)), corrected(&[4, 5], &[]));
    assert_eq!(krl(&point(18)), corrected(&[4, 5], &["W0926 5"]));
}

#[test]
fn named_parts_of_rapid_targets_are_no_obstacle() {
    let data = "CONST extjoint e0:=[9E9,9E9,9E9,9E9,9E9,9E9];\nCONST confdata c0:=[0,-1,0,0];";
    let start = "MoveAbsJ [[0,0,0,0,30,0],e0],v100,fine,tool0;";
    let pose = "[[1500,100,1300],[0.5,0,0.8660254,0],c0,e0]";
    assert_eq!(rapid(data, &format!("{start}|MoveL {pose},v100,fine,tool0;")), corrected(&[5, 6], &[]));
    // Position and orientation of a variable stay: others may use them.
    let position = format!("{data}\nCONST pos p0:=[1500,100,1300];");
    let named = "MoveL [p0,[0.5,0,0.8660254,0],c0,e0],v100,fine,tool0;";
    assert_eq!(rapid(&position, &format!("{start}|{named}")), corrected(&[6], &["W0905 7"]));
    // A tool that is computed does not matter at axis angles.
    let tool = format!("{data}\nPERS tooldata t0:=[TRUE,[[0,0,0],[1,0,0,0]],[1,[0,0,20],[1,0,0,0],0,0,0]];");
    let computed = "t0:=Wanted();|MoveAbsJ [[0,0,0,0,30,0],e0],v100,fine,t0;";
    let with_tool = format!(
        "{computed}|MoveL {pose},v100,fine,tool0;|MoveL [[1500,150,1300],[0.5,0,0.8660254,0],c0,e0],v100,fine,t0;"
    );
    assert_eq!(rapid(&tool, &with_tool), corrected(&[7, 8], &["W0905 9"]));
}

#[test]
fn options_of_fanuc_motions_are_known_or_leave_their_motion() {
    let line = |options: &str| format!("   3:J P[1] 100% FINE    ;|   4:L P[2] 100mm/sec FINE {options}   ;");
    for options in [
        "SPOT[SD=1,P=1,t=2.0,S=1,ED=1]",
        "ACC100 TB    .10sec,P-SPS",
        "PRESS_MOTN",
        "Ind.EV50%",
        "TA .10sec,CALL A(1,2)",
    ] {
        assert_eq!(fanuc(&line(options)), corrected(&[5, 6], &[]), "{options}");
    }
    assert_eq!(fanuc("   3:J P[1] 100% FINE    ;|   4:L P[2] max_speed FINE   ;"), corrected(&[5, 6], &[]));
    for options in ["Offset,PR[1:Test]", "Tool_Offset,PR[2]", "WHAT_IS_THIS"] {
        assert_eq!(fanuc(&line(options)), corrected(&[5], &["W0905 6"]), "{options}");
    }
    // The point of a motion that stays is not corrected elsewhere.
    let twice = "   3:J P[1] 100% FINE    ;|   4:L P[2] 100mm/sec FINE Offset,PR[1]   ;|   5:L P[2] 100mm/sec FINE   ;";
    assert_eq!(fanuc(twice), corrected(&[5], &["W0905 6", "W0905 7"]));
    assert_eq!(fanuc("   3:L P[2] 100mm/sec FINE Offset,PR[1]   ;"), Err("E0901 5".into()));
}
