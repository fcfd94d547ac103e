//! Small programs with the frames that are in force at each motion, or the refusal.
//!
//! The answers are derived by hand from the manuals of the languages: KUKA *Expert Programming* and *BAS* of the system
//! files; ABB *Technical reference manual - RAPID instructions, functions and data types*; Universal Robots *The URScript
//! Programming Language*; FANUC *HandlingTool Setup and Operations Manual*. A program with the wrong answer would be corrected wrongly without a word.
//!
//! In a source `|` ends a line, and some words stand for values (see each `text`). An answer has, for each point, the line of
//! its first motion and its frames by their numbers (`axes` for axis angles), then what stays as it is and the warnings, with
//! their lines; or the code and the line of the refusal.

use dbbd_job::program::fanuc::{self, GivenFrames};
use dbbd_job::program::{CompensationFinding, Frames, Text, krl, rapid, urscript};
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::robot::Pose;

use crate::program::compensate::Branch;

/// The number of a tool (100 mm of Z each) and of a base (1000 mm of X each).
fn numbers(frames: Option<&Frames>) -> String {
    frames.map_or("axes".into(), |frames| {
        format!("{}/{}", frames.tool.position.z / 100.0, frames.base.position.x / 1000.0)
    })
}

fn line(wrong: &Diagnostic) -> usize {
    wrong.line_number()
}

/// The answer from points (line, text), and what was reported.
fn answer(mut points: Vec<(usize, String)>, reported: impl Iterator<Item = Diagnostic>) -> String {
    points.sort();
    let points = points.into_iter().map(|(line, frames)| format!("{line}={frames}"));
    let mut reported: Vec<(usize, String)> =
        reported.map(|wrong| (line(&wrong), format!("{}@{}", wrong.code().as_str(), line(&wrong)))).collect();
    reported.sort();
    points.chain(reported.into_iter().map(|(_, text)| text)).collect::<Vec<_>>().join(" ")
}

fn refusal(wrong: &Diagnostic) -> String {
    format!("{} {}", wrong.code().as_str(), line(wrong))
}

fn check(cases: &[(&str, &str)], answer: impl Fn(&str) -> String) {
    let wrong: Vec<String> = cases
        .iter()
        .filter_map(|(source, wanted)| {
            let found = answer(source);
            (found != *wanted).then(|| format!("{source}\n  wanted {wanted}\n  found  {found}"))
        })
        .collect();
    assert!(wrong.is_empty(), "{} of {} are wrong:\n{}", wrong.len(), cases.len(), wrong.join("\n"));
}

/// `PP` is a pose, `QQ` axis angles, `T1` to `T3` are TCPs.
fn of_urscript(source: &str, given: Option<Pose>) -> String {
    let mut text = source.replace('|', "\n").replace("PP", "p[0.5,0.1,0.3,0,3.14,0]");
    text = text.replace("QQ", "[0,-1.5,1.5,0,1,0]");
    for tool in 1..=3 {
        text = text.replace(&format!("T{tool}"), &format!("p[0,0,0.{tool},0,0,0]"));
    }
    let text = Text { file: "P.script", text: &text };
    match urscript::read(text, given) {
        Err(wrong) => refusal(&wrong),
        Ok(read) => {
            let points = read.points.iter().map(|point| {
                let tool = numbers(point.frames.as_ref());
                (text.line(point.first_use.start), tool.trim_end_matches("/0").to_owned())
            });
            answer(points.collect(), read.not_corrected.iter().chain(&read.warnings).cloned())
        }
    }
}

const URSCRIPT: &[(&str, &str)] = &[
    // One way.
    ("def f():|set_tcp(T1)|movel(PP)|end", "3=1"),
    ("def f():|movel(PP)|end", "E0901 2"),
    ("def f():|movel(PP)|set_tcp(T1)|end", "E0901 2"),
    ("set_tcp(T1)|movel(PP)", "2=1"),
    ("def f():|movej(QQ)|end", "2=axes"),
    ("def f():|set_tcp(T1)|movel(PP)|set_tcp(T2)|movel(PP)|end", "3=1 5=2"),
    ("def f():|set_tcp(T1)|movec(PP, PP)|end", "3=1 3=1"),
    ("def f():|set_tcp(T1, \"grip\")|movel(PP)|end", "3=1"),
    ("def f():|set_tcp(pose=T1)|movel(PP)|end", "3=1"),
    ("def f():|set_tcp(pose_add(T1, T2))|movel(PP)|end", "E0901 3"),
    ("def f():|set_tcp(get_tcp_offset())|movel(PP)|end", "E0901 3"),
    ("def f():|set_tcp(unknown)|movel(PP)|end", "E0901 3"),
    ("def f():|set_tcp(|T1|)|movel(PP)|end", "5=1"),
    // The TCP in a variable: set_tcp copies the value.
    ("def f():|t=T1|set_tcp(t)|movel(PP)|end", "4=1"),
    ("def f():|t=T1|t=T2|set_tcp(t)|movel(PP)|end", "5=2"),
    ("def f():|t=T1|t[2]=0.2|set_tcp(t)|movel(PP)|end", "E0901 5"),
    ("def f():|t=T1|set_tcp(t)|t[2]=0.2|movel(PP)|end", "5=1"),
    ("def f():|x=0.1|set_tcp(p[0,0,x,0,0,0])|movel(PP)|end", "4=1"),
    ("def f():|if a():|t=T1|else:|t=T2|end|set_tcp(t)|movel(PP)|end", "E0901 8"),
    ("def f():|if a():|t=T1|else:|t=T1|end|set_tcp(t)|movel(PP)|end", "E0901 8"),
    // Choices.
    ("def f():|set_tcp(T1)|if a():|set_tcp(T2)|end|movel(PP)|end", "E0901 6"),
    ("def f():|set_tcp(T1)|if a():|set_tcp(T1)|end|movel(PP)|end", "6=1"),
    ("def f():|if a():|set_tcp(T2)|end|movel(PP)|end", "E0901 5"),
    ("def f():|if a():|set_tcp(T2)|else:|set_tcp(T2)|end|movel(PP)|end", "7=2"),
    ("def f():|if a():|set_tcp(T1)|else:|set_tcp(T2)|end|movel(PP)|end", "E0901 7"),
    ("def f():|if a():|set_tcp(T1)|elif b():|set_tcp(T1)|end|movel(PP)|end", "E0901 7"),
    ("def f():|if a():|set_tcp(T1)|elif b():|set_tcp(T1)|else:|set_tcp(T1)|end|movel(PP)|end", "9=1"),
    ("def f():|set_tcp(T1)|if a():|set_tcp(T2)|movel(PP)|end|set_tcp(T3)|movel(PP)|end", "5=2 8=3"),
    ("def f():|set_tcp(T1)|if a():|movel(PP)|set_tcp(T2)|else:|movel(PP)|end|end", "4=1 7=1"),
    ("def f():|set_tcp(T1)|if a():|set_tcp(T2)|elif b():|movel(PP)|end|end", "6=1"),
    ("def f():|set_tcp(T1)|if a():|set_tcp(T2)|return 0|end|movel(PP)|end", "7=1"),
    ("def f():|set_tcp(T1)|if a():|set_tcp(T2)|halt|end|movel(PP)|end", "7=1"),
    ("def f():|set_tcp(T1)|if a():|if b():|set_tcp(T2)|end|end|movel(PP)|end", "E0901 8"),
    ("def f():|set_tcp(T1)|if a():|if b():|set_tcp(T2)|end|set_tcp(T1)|end|movel(PP)|end", "9=1"),
    ("def f():|set_tcp(T1)|if (a() and|b()):|set_tcp(T2)|end|movel(PP)|end", "E0901 7"),
    // Loops: the second pass begins with what the first one leaves.
    ("def f():|set_tcp(T1)|while a():|movel(PP)|set_tcp(T2)|end|end", "E0901 4"),
    ("def f():|set_tcp(T1)|while a():|movel(PP)|set_tcp(T1)|end|end", "4=1"),
    ("def f():|set_tcp(T1)|while a():|set_tcp(T2)|movel(PP)|end|end", "5=2"),
    ("def f():|set_tcp(T1)|while a():|set_tcp(T2)|end|movel(PP)|end", "E0901 6"),
    ("def f():|set_tcp(T1)|while True:|set_tcp(T2)|break|end|movel(PP)|end", "7=2"),
    ("def f():|set_tcp(T1)|while (True):|movel(PP)|end|set_tcp(T2)|movel(PP)|end", "4=1 W0905@7"),
    ("def f():|set_tcp(T1)|while a():|if b():|set_tcp(T2)|continue|end|movel(PP)|end|end", "E0901 8"),
    ("def f():|set_tcp(T1)|while a():|if b():|set_tcp(T2)|break|end|movel(PP)|end|end", "8=1"),
    (
        "def f():|set_tcp(T1)|while a():|movel(PP)|if b():|break|end|set_tcp(T2)|movel(PP)|set_tcp(T1)|end|movel(PP)|end",
        "4=1 9=2 12=1",
    ),
    ("def f():|set_tcp(T1)|while a():|while b():|movel(PP)|end|set_tcp(T2)|end|end", "E0901 5"),
    ("def f():|set_tcp(T1)|while not is_steady():|sync()|end|movel(PP)|end", "6=1"),
    ("def f():|set_tcp(T1)|while a():|return|end|movel(PP)|end", "6=1"),
    // Functions.
    ("def g():|set_tcp(T2)|end|def f():|set_tcp(T1)|g()|movel(PP)|end", "7=2"),
    ("def f():|def g():|set_tcp(T2)|end|set_tcp(T1)|g()|movel(PP)|end", "7=2"),
    ("def f():|def g():|movel(PP)|end|set_tcp(T1)|g()|end", "3=1"),
    ("def f():|def g():|movel(PP)|end|set_tcp(T1)|g()|g()|end", "3=1"),
    ("def f():|def g():|movel(PP)|end|set_tcp(T1)|g()|set_tcp(T2)|g()|end", "E0904 3"),
    ("def f():|def g():|movel(PP)|end|set_tcp(T1)|movel(PP)|end", "6=1 W0905@3"),
    ("def f():|def g():|if a():|set_tcp(T2)|end|end|set_tcp(T1)|g()|movel(PP)|end", "E0901 9"),
    ("def f():|def g():|set_tcp(T2)|return True|end|set_tcp(T1)|if g():|movel(PP)|end|end", "8=2"),
    ("def f():|def g():|set_tcp(T2)|return 1|end|set_tcp(T1)|x=g()|movel(PP)|end", "8=2"),
    ("def f():|def g():|set_tcp(T2)|end|def h():|g()|end|set_tcp(T1)|h()|movel(PP)|end", "10=2"),
    ("def f():|def g():|movel(PP)|set_tcp(T2)|g()|end|set_tcp(T1)|g()|end", "E0901 3"),
    ("def f():|def g(x):|movel(x)|end|set_tcp(T1)|g(PP)|end", "3=1"),
    ("def f():|def g(x):|movel(x)|end|set_tcp(T1)|g(PP)|g(PP)|end", "3=1 3=1"),
    ("def f():|def g(t):|set_tcp(t)|end|g(T2)|movel(PP)|end", "6=2"),
    ("def f():|def g(t):|set_tcp(t)|end|g(t=T2)|movel(PP)|end", "6=2"),
    ("def f():|def g(t=T2):|set_tcp(t)|end|g()|movel(PP)|end", "6=2"),
    ("def f():|def g(t=T2):|set_tcp(t)|end|g(T3)|movel(PP)|end", "6=3"),
    ("def f():|def g(t=T2):|set_tcp(t)|return 1|end|sleep(g(T3))|movel(PP)|end", "E0901 7"),
    ("def f():|def g(q=QQ, n=1):|movej(q)|end|g()|end", "3=axes"),
    ("def f():|def g(n, q=[0,0]):|sleep(n)|end|set_tcp(T1)|g(1)|movel(PP)|end", "7=1"),
    ("def f():|def g():|global t=T2|end|global t=T1|g()|set_tcp(t)|movel(PP)|end", "8=2"),
    ("def f():|def g():|t=T2|end|t=T1|g()|set_tcp(t)|movel(PP)|end", "E0901 8"),
    ("def f():|def g(t):|t=T2|end|t=T1|g(t)|set_tcp(t)|movel(PP)|end", "8=1"),
    ("def f():|def g():|set_tcp(T2)|return 1|end|set_tcp(T1)|movel(PP, a=g())|end", "7=2"),
    ("def f():|set_tcp(T1)|dev.set_tcp(T2)|movel(PP)|end", "4=1"),
    ("def f():|def movel(x):|set_tcp(T2)|movej(x)|end|movel(PP)|end", "4=2"),
    // Threads run at any time, but only if they are started.
    ("def f():|thread w():|set_tcp(T2)|end|run w()|set_tcp(T1)|movel(PP)|end", "E0901 7"),
    ("def f():|thread w():|set_tcp(T2)|end|h=run w()|set_tcp(T1)|movel(PP)|end", "E0901 7"),
    ("def f():|thread w():|set_tcp(T2)|end|set_tcp(T1)|movel(PP)|end", "6=1"),
    ("def f():|thread w():|sync()|end|run w()|set_tcp(T1)|movel(PP)|end", "7=1"),
    ("def f():|def g():|set_tcp(T2)|end|thread w():|g()|end|run w()|set_tcp(T1)|movel(PP)|end", "E0901 10"),
    ("def f():|t=T1|thread w():|t=T2|end|run w()|set_tcp(t)|movel(PP)|end", "E0901 8"),
    ("def f():|a=PP|thread w():|a[2]=0.5|end|run w()|set_tcp(T1)|movel(a)|end", "W0905@8"),
    // Points in variables.
    ("def f():|set_tcp(T1)|a=PP|movel(a)|end", "4=1"),
    ("def f():|set_tcp(T1)|a=PP|a[2]=0.1|movel(a)|end", "W0905@5"),
    ("def f():|set_tcp(T1)|a=PP|movel(a)|a[2]=0.1|movel(a)|end", "4=1 W0905@6"),
    ("def f():|set_tcp(T1)|a=PP|a=PP|movel(a)|end", "5=1"),
    ("def f():|set_tcp(T1)|a=PP|movel(a)|a=PP|movel(a)|end", "4=1 6=1"),
    ("def f():|set_tcp(T1)|a=PP|while b():|movel(a)|a=PP|end|end", "W0905@5"),
    ("def f():|set_tcp(T1)|if b():|a=PP|else:|a=PP|end|movel(a)|end", "W0905@8"),
    ("def f():|set_tcp(T1)|a=PP|movel(a)|set_tcp(T2)|movel(a)|end", "E0904 6"),
    ("def f():|set_tcp(T1)|a=PP|b=a|movel(b)|end", "5=1"),
    ("def f():|set_tcp(T1)|a=pose_trans(PP, PP)|movel(a)|end", "W0905@4"),
    ("def f():|set_tcp(T1)|z=0.3|movel(p[0.5,0.1,z,0,3.14,0])|end", "W0905@4"),
    ("def f():|set_tcp(T1)|movep(PP, r=0.01)|end", "W0905@3"),
    ("def f():|set_tcp(T1)|movep(pose_trans(PP, PP), r=0.01)|end", "W0905@3"),
    ("def f():|set_tcp(T1)|x=movel(PP)|end", "W0905@3"),
    // What PolyScope saves.
    ("def f():|set_tcp(T1)|a_p=p[.5, -.1, .3, .0, 3.14, -.000027]|movel(a_p)|end", "4=1"),
    ("def f():|set_tcp(T1)|$ 1 \"BeforeStart\"|$ 2 \"v≔1\" \"noBreak\"|movel(PP)|end", "5=1"),
    ("def f():|set_tcp(T1)|movej(get_inverse_kin(PP, qnear=QQ), a=1.4)|end", "3=1"),
    ("def f():|set_tcp(T1)|movej(get_inverse_kin(PP, QQ))|end", "3=1"),
    ("def f():|set_tcp(T1)|movej(get_inverse_kin(PP))|end", "3=1"),
    ("def f():|set_tcp(T1)|movej(get_inverse_kin(PP, qnear=QQ, tcp=T2))|end", "3=2"),
    ("def f():|set_tcp(T1)|movej(get_inverse_kin(PP, qnear=other()))|end", "W0905@3"),
    ("def f():|set_tcp(T1)|movej(get_inverse_kin(PP, qnear=get_actual_joint_positions()))|end", "3=1"),
    ("def f():|set_tcp(T1)|global a_p=PP|global a_q=QQ|movej(get_inverse_kin(a_p, qnear=a_q))|end", "5=1"),
    ("def f():|set_tcp(T1)|global a_p=PP|movej(get_inverse_kin(a_p))|set_tcp(T2)|movel(a_p)|end", "E0904 6"),
    ("def f():|set_tcp(T1)|q=get_inverse_kin(PP)|movej(q)|end", "W0905@4"),
];

#[test]
fn urscript_frames() {
    check(URSCRIPT, |source| of_urscript(source, None));
}

/// With the TCP `T1` of the user.
const GIVEN: &[(&str, &str)] = &[
    ("def f():|movel(PP)|end", "2=1"),
    ("def f():|set_tcp(T1)|movel(PP)|end", "3=1"),
    ("def f():|set_tcp(T2)|movel(PP)|end", "E0902 2"),
    ("def f():|if a():|set_tcp(get_tcp_offset())|end|movel(PP)|end", "E0901 5"),
    ("def f():|set_tcp(get_tcp_offset())|movel(PP)|end", "E0901 3"),
];

#[test]
fn urscript_frames_of_the_user() {
    let given = Pose::from_xyzabc([0.0, 0.0, 100.0, 0.0, 0.0, 0.0]);
    check(GIVEN, |source| of_urscript(source, Some(given)));
}

/// `PT` is a pose. `T1`, `T2`, `B1`, `B2` are tools and bases; those of the `$config.dat` have the same numbers.
fn of_krl(source: &str) -> String {
    let text = source.replace('|', "\n").replace(" PT", " {X 1,Y 2,Z 3,A 0,B 0,C 0}");
    let frame = |x: usize, z: usize| format!("{{X {x},Y 0,Z {z},A 0,B 0,C 0}}");
    let (mut data, mut config) = ("DEFDAT P\n".to_owned(), "DEFDAT $CONFIG\n".to_owned());
    for n in 1..=2 {
        data += &format!("DECL FRAME T{n}={}\nDECL FRAME B{n}={}\n", frame(0, 100 * n), frame(1000 * n, 0));
        data += &format!("DECL FDAT FP{n}={{TOOL_NO {n},BASE_NO {n},IPO_FRAME #BASE}}\n");
        data += &format!("DECL E6POS XP{n}={{X 1,Y 2,Z 3,A 0,B 0,C 0,S 2,T 2}}\n");
        config += &format!("TOOL_DATA[{n}]={}\nBASE_DATA[{n}]={}\n", frame(0, 100 * n), frame(1000 * n, 0));
    }
    data += "DECL E6AXIS XQ={A1 0,A2 -90,A3 90,A4 0,A5 10,A6 0}\nDECL FDAT FTCP={TOOL_NO 1,BASE_NO 1,IPO_FRAME #TCP}\n";
    let files = krl::Files {
        source: Text { file: "P.src", text: &text },
        data: Some(Text { file: "P.dat", text: &data }),
        config: Some(Text { file: "$config.dat", text: &config }),
    };
    match krl::read(files, krl::Given::default()) {
        Err(wrong) => refusal(&wrong),
        Ok(read) => {
            let points = read
                .points
                .iter()
                .map(|point| (files.source.line(point.first_use.start), numbers(point.frames.as_ref())));
            answer(points.collect(), read.not_corrected.iter().chain(&read.warnings).cloned())
        }
    }
}

const KRL: &[(&str, &str)] = &[
    // One way.
    ("DEF P()|$TOOL=T1|$BASE=B1|LIN PT|END", "4=1/1"),
    ("DEF P()|LIN PT|END", "E0901 2"),
    ("DEF P()|$TOOL=T1|LIN PT|END", "E0901 3"),
    ("DEF P()|PTP XQ|END", "2=axes"),
    ("DEF P()|$TOOL=T1|$BASE=B1|LIN PT|$BASE=B2|LIN PT|END", "4=1/1 6=1/2"),
    ("DEF P()|$tool=t1|$base=b2|lin XP1|END", "4=1/2"),
    ("DEF P()|$TOOL=TOOL_DATA[2]|$BASE=$NULLFRAME|LIN PT|END", "4=2/0"),
    ("DEF P()|BAS(#TOOL,1)|BAS (#BASE,2)|LIN PT|END", "4=1/2"),
    ("DEF P()|BAS(#TOOL,0)|BAS(#BASE,0)|LIN PT|END", "4=0/0"),
    ("DEF P()|BAS(#TOOL,1)|BAS(#BASE,N)|LIN PT|END", "E0901 4"),
    ("DEF P()|BAS(#TOOL,3)|BAS(#BASE,1)|LIN PT|END", "E0901 4"),
    ("DEF P()|$TOOL=T1|$BASE=B1|BAS(#EX_BASE,1)|LIN PT|END", "E0901 5"),
    ("DEF P()|$TOOL=T1|$BASE=B1|BAS(#INITMOV,0)|LIN PT|END", "E0901 5"),
    ("DEF P()|BAS(#INITMOV,0)|$TOOL=T1|$BASE=B1|LIN PT|END", "5=1/1"),
    ("DEF P()|$TOOL=T1|$BASE=B1:B2|LIN PT|END", "E0901 4"),
    ("DEF P()|$TOOL=T1|$BASE=B1|$BASE.X=5|LIN PT|END", "E0901 5"),
    ("DEF P()|$TOOL=T1|$BASE=F()|LIN PT|END", "E0901 4"),
    ("DEF P()|TOOL_DATA[1]=T2|BAS(#TOOL,1)|$BASE=B1|LIN PT|END", "E0901 5"),
    ("DEF P()|BASE_DATA[1].X=5|$TOOL=T1|BAS(#BASE,1)|LIN PT|END", "E0901 5"),
    ("DEF P()|T1.Z=5|$TOOL=T1|$BASE=B1|LIN PT|END", "E0901 5"),
    // Inline forms: BAS sets the frames of FDAT_ACT.
    ("DEF P()|FDAT_ACT=FP1|BAS(#PTP_PARAMS,100)|PTP XP1|END", "4=1/1"),
    (
        "DEF P()|FDAT_ACT=FP1|BAS(#CP_PARAMS,0.2)|LIN XP1|FDAT_ACT=FP2|BAS(#CP_PARAMS,0.2)|LIN XP2|END",
        "4=1/1 7=2/2",
    ),
    ("DEF P()|FDAT_ACT=FP1|$BASE=B2|BAS(#CP_PARAMS,0.2)|LIN PT|END", "5=1/1"),
    ("DEF P()|FDAT_ACT=FP1|$BASE=B2|LIN PT|END", "4=1/2"),
    ("DEF P()|FDAT_ACT=FTCP|BAS(#CP_PARAMS,0.2)|LIN PT|END", "E0901 4"),
    ("DEF P()|FDAT_ACT=FNONE|BAS(#CP_PARAMS,0.2)|LIN PT|END", "E0901 4"),
    // Splines.
    ("DEF P()|SLIN PT WITH $TOOL=T1, $BASE=B2|END", "2=1/2"),
    ("DEF P()|$TOOL=T1|$BASE=B1|SLIN PT WITH $BASE=B2|SLIN PT|END", "4=1/2 5=1/1"),
    (
        "DEF P()|$TOOL=T1|$BASE=B1|SPLINE WITH $BASE=B2|SPL PT|SLIN PT|ENDSPLINE|LIN PT|END",
        "5=1/2 6=1/2 8=1/1",
    ),
    ("DEF P()|SPTP PT WITH $TOOL=STOOL2(FP2), $BASE=SBASE(FP2.BASE_NO)|END", "2=2/2"),
    ("DEF P()|$TOOL=T1|$BASE=B1|SLIN PT WITH $IPO_MODE=#TCP|END", "E0901 4"),
    // Choices.
    ("DEF P()|$TOOL=T1|$BASE=B1|IF $IN[1] THEN|$BASE=B2|ENDIF|LIN PT|END", "E0901 7"),
    ("DEF P()|$TOOL=T1|$BASE=B1|IF $IN[1] THEN|$BASE=B1|ENDIF|LIN PT|END", "7=1/1"),
    ("DEF P()|$TOOL=T1|IF $IN[1] THEN|$BASE=B2|ELSE|$BASE=B2|ENDIF|LIN PT|END", "8=1/2"),
    ("DEF P()|$TOOL=T1|IF $IN[1] THEN|$BASE=B1|ELSE|$BASE=B2|ENDIF|LIN PT|END", "E0901 8"),
    ("DEF P()|$TOOL=T1|IF $IN[1] THEN|$BASE=B1|LIN PT|ELSE|$BASE=B2|LIN PT|ENDIF|END", "5=1/1 8=1/2"),
    ("DEF P()|$TOOL=T1|SWITCH N|CASE 1|$BASE=B1|CASE 2|$BASE=B1|ENDSWITCH|LIN PT|END", "E0901 9"),
    ("DEF P()|$TOOL=T1|SWITCH N|CASE 1|$BASE=B1|DEFAULT|$BASE=B1|ENDSWITCH|LIN PT|END", "9=1/1"),
    ("DEF P()|$TOOL=T1|SWITCH N|CASE 1,2|$BASE=B1|DEFAULT|HALT|ENDSWITCH|LIN PT|END", "E0901 9"),
    ("DEF P()|$TOOL=T1|SWITCH N|CASE 1|$BASE=B1|DEFAULT|RETURN|ENDSWITCH|LIN PT|END", "9=1/1"),
    ("DEF P()|$TOOL=T1|$BASE=B1|IF $IN[1] THEN|$BASE=B2|RETURN|ENDIF|LIN PT|END", "8=1/1"),
    // Loops.
    ("DEF P()|$TOOL=T1|$BASE=B1|LOOP|LIN PT|$BASE=B2|ENDLOOP|END", "E0901 5"),
    ("DEF P()|$TOOL=T1|$BASE=B1|LOOP|LIN PT|$BASE=B1|ENDLOOP|END", "5=1/1"),
    ("DEF P()|$TOOL=T1|$BASE=B1|LOOP|$BASE=B2|LIN PT|ENDLOOP|END", "6=1/2"),
    ("DEF P()|$TOOL=T1|$BASE=B1|LOOP|$BASE=B2|EXIT|ENDLOOP|LIN PT|END", "8=1/2"),
    ("DEF P()|$TOOL=T1|$BASE=B1|LOOP|IF $IN[1] THEN|EXIT|ENDIF|$BASE=B2|ENDLOOP|LIN PT|END", "E0901 10"),
    ("DEF P()|$TOOL=T1|$BASE=B1|FOR I=1 TO 3|$BASE=B2|ENDFOR|LIN PT|END", "E0901 7"),
    ("DEF P()|$TOOL=T1|$BASE=B1|FOR I=1 TO 3|LIN PT|ENDFOR|LIN PT|END", "5=1/1 7=1/1"),
    ("DEF P()|$TOOL=T1|$BASE=B1|WHILE $IN[1]|LIN PT|$BASE=B2|ENDWHILE|END", "E0901 5"),
    ("DEF P()|$TOOL=T1|$BASE=B1|REPEAT|$BASE=B2|UNTIL $IN[1]|LIN PT|END", "7=1/2"),
    ("DEF P()|$TOOL=T1|$BASE=B1|REPEAT|LIN PT|$BASE=B2|UNTIL $IN[1]|END", "E0901 5"),
    ("DEF P()|$TOOL=T1|$BASE=B1|LOOP|LIN PT|ENDLOOP|LIN PT|END", "5=1/1 W0905@7"),
    // Jumps.
    ("DEF P()|$TOOL=T1|$BASE=B1|AGAIN:|LIN PT|$BASE=B2|GOTO AGAIN|END", "E0901 5"),
    ("DEF P()|$TOOL=T1|$BASE=B1|AGAIN:|LIN PT|IF $IN[1] THEN|GOTO AGAIN|ENDIF|END", "5=1/1"),
    ("DEF P()|$TOOL=T1|$BASE=B1|AGAIN:|LIN PT|IF $IN[1] THEN|$BASE=B2|goto again|ENDIF|END", "E0901 5"),
    ("DEF P()|$TOOL=T1|$BASE=B1|GOTO OVER|$BASE=B2|OVER:|LIN PT|END", "7=1/1"),
    ("DEF P()|$TOOL=T1|$BASE=B1|IF $IN[1] THEN|GOTO OVER|ENDIF|$BASE=B2|OVER :|LIN PT|END", "E0901 9"),
    (
        "DEF P()|$TOOL=T1|$BASE=B1|LOOP|IF $IN[1] THEN|$BASE=B2|GOTO OUT|ENDIF|LIN PT|ENDLOOP|OUT:|LIN PT|END",
        "9=1/1 12=1/2",
    ),
    // Routines of the file.
    ("DEF P()|$TOOL=T1|$BASE=B1|S()|LIN PT|END|DEF S()|$BASE=B2|END", "5=1/2"),
    ("DEF P()|$TOOL=T1|$BASE=B1|S()|LIN PT|END|DEF S()|HALT|END", "5=1/1"),
    ("DEF P()|$TOOL=T1|$BASE=B1|S()|LIN PT|END|DEF S()|IF $IN[1] THEN|$BASE=B2|ENDIF|END", "E0901 5"),
    ("DEF P()|$TOOL=T1|$BASE=B1|S()|END|DEF S()|LIN PT|END", "7=1/1"),
    ("DEF P()|$TOOL=T1|$BASE=B1|S()|$BASE=B2|S()|END|DEF S()|LIN PT|END", "E0904 9"),
    ("DEF P()|$TOOL=T1|$BASE=B1|S ( )|s()|END|DEF S()|LIN PT|END", "8=1/1"),
    (
        "DEF P()|$TOOL=T1|$BASE=B1|S(TRUE)|LIN PT|END|DEF S(X:IN)|BOOL X|$BASE=B2|IF X THEN|RETURN|ENDIF|END",
        "5=1/2",
    ),
    (
        "DEF P()|$TOOL=T1|$BASE=B1|IF F() THEN|LIN PT|ENDIF|END|DEFFCT BOOL F()|$BASE=B2|RETURN TRUE|ENDFCT",
        "5=1/2",
    ),
    ("DEF P()|$TOOL=T1|$BASE=B1|N=F()|LIN PT|END|DEFFCT INT F()|$BASE=B2|RETURN 1|ENDFCT", "5=1/2"),
    ("DEF P()|$TOOL=T1|$BASE=B1|$BASE=F()|LIN PT|END|DEFFCT FRAME F()|RETURN B2|ENDFCT", "E0901 5"),
    ("DEF P()|$TOOL=T1|$BASE=B1|A()|LIN PT|END|DEF A()|B()|END|DEF B()|$BASE=B2|END", "5=1/2"),
    ("DEF P()|$TOOL=T1|$BASE=B1|S()|END|DEF S()|LIN PT|$BASE=B2|S()|END", "E0901 7"),
    ("DEF P()|$TOOL=T1|$BASE=B1|LIN PT|END|DEF S()|LIN PT|END", "4=1/1 W0905@7"),
    ("DEF P()|$TOOL=T1|$BASE=B1|S()|END|GLOBAL DEF S()|LIN PT|END", "E0901 7"),
    // Routines that run at any time.
    (
        "DEF P()|INTERRUPT DECL 5 WHEN $IN[1] DO S()|INTERRUPT ON 5|$TOOL=T1|$BASE=B1|LIN PT|END|DEF S()|$BASE=B2|END",
        "E0901 6",
    ),
    (
        "DEF P()|INTERRUPT DECL 5 WHEN $IN[1] DO S()|$TOOL=T1|$BASE=B1|LIN PT|END|DEF S()|$OUT[1]=TRUE|END",
        "5=1/1",
    ),
    (
        "DEF P()|GLOBAL INTERRUPT DECL 3 WHEN $STOPMESS==TRUE DO IR_STOPM ( )|$TOOL=T1|$BASE=B1|LIN PT|END",
        "5=1/1",
    ),
    (
        "DEF P()|INTERRUPT DECL 5 WHEN $IN[1] DO S()|$TOOL=T1|$BASE=B1|LIN PT|END|DEF S()|LIN PT|END",
        "5=1/1 W0905@8",
    ),
    (
        "DEF P()|$TOOL=T1|$BASE=B1|TRIGGER WHEN DISTANCE=0 DELAY=0 DO S() PRIO=-1|LIN PT|END|DEF S()|$TOOL=T2|END",
        "E0901 5",
    ),
    (
        "DEF P()|INTERRUPT DECL 5 WHEN $IN[1] DO S()|$TOOL=T1|$BASE=B1|PTP XQ|END|DEF S()|$BASE=B2|END",
        "5=axes",
    ),
    (
        "DEF P()|INTERRUPT DECL 5 WHEN $IN[1] DO S()|$TOOL=T1|$BASE=B1|LIN PT|END|DEF S()|$ABS_ACCUR=TRUE|END",
        "E0922 5",
    ),
    // Routines of other files.
    ("DEF P()|$TOOL=T1|$BASE=B1|GRIP()|LIN PT|END", "5=1/1 W0921@5"),
    ("DEF P()|$TOOL=T1|$BASE=B1|GRIP()|LIN PT|GRIP()|LIN PT|END", "5=1/1 7=1/1 W0921@5"),
    ("DEF P()|GRIP()|$TOOL=T1|$BASE=B1|LIN PT|END", "5=1/1"),
    ("DEF P()|FDAT_ACT=FP1|GRIP()|BAS(#CP_PARAMS,0.2)|LIN PT|END", "5=1/1"),
    ("DEF P()|$TOOL=T1|$BASE=B1|GRIP()|PTP XQ|END", "5=axes"),
    ("DEF P()|$TOOL=T1|$BASE=B1|IF $IN[1] THEN|GRIP(1,TRUE)|ENDIF|LIN PT|END", "7=1/1 W0921@7"),
    ("DEF P()|CALC(B1)|$TOOL=T1|$BASE=B1|LIN PT|END", "5=1/1 W0921@2"),
    ("DEF P()|CALC(B2)|$TOOL=T1|$BASE=B1|LIN PT|END", "5=1/1 W0905@2"),
    ("DEF P()|CALC(B1)|$TOOL=T1|$BASE=B1|LIN PT|END|DEF CALC(F:OUT)|FRAME F|F.X=5|END", "5=1/1 W0921@2"),
    ("DEF P()|EXT GRIP()|$TOOL=T1|$BASE=B1|PULSE($OUT[1],TRUE,0.1)|LIN PT|END", "6=1/1"),
    // What the controller does with a pose.
    ("DEF P()|$TOOL=T1|$BASE=B1|$IPO_MODE=#TCP|LIN PT|END", "E0901 5"),
    ("DEF P()|$TOOL=T1|$BASE=B1|$IPO_MODE=#TCP|$IPO_MODE = #BASE|LIN PT|END", "6=1/1"),
    ("DEF P()|$TOOL=T1|$BASE=B1|$IPO_MODE=#TCP|PTP XQ|END", "5=axes"),
    ("DEF P()|$IPO_MODE=#TCP|FDAT_ACT=FP1|BAS(#CP_PARAMS,0.2)|LIN PT|END", "5=1/1"),
    ("DEF P()|$TOOL=T1|$BASE=B1|IF $IN[1] THEN|$IPO_MODE=#TCP|ENDIF|LIN PT|END", "E0901 7"),
    ("DEF P()|$ABS_ACCUR=TRUE|$TOOL=T1|$BASE=B1|LIN PT|END", "E0922 5"),
    ("DEF P()|$ABS_ACCUR=FALSE|$TOOL=T1|$BASE=B1|LIN PT|END", "5=1/1"),
    ("DEF P()|$ABS_ACCUR=TRUE|PTP XQ|END", "3=axes"),
    ("DEF P()|$DEACTIVATE_ABS_ACCUR=FALSE|$TOOL=T1|$BASE=B1|LIN PT|END", "E0922 5"),
    ("DEF P()|$DEACTIVATE_ABS_ACCUR=TRUE|$TOOL=T1|$BASE=B1|LIN PT|END", "5=1/1"),
    ("DEF P()|$ROBROOT={X 100,Y 0,Z 0,A 0,B 0,C 0}|$TOOL=T1|$BASE=B1|LIN PT|END", "E0901 5"),
    ("DEF P()|$TOOL=T1|$BASE=B1|S()|LIN PT|END|DEF S()|$ABS_ACCUR=TRUE|END", "E0922 5"),
    // Points.
    ("DEF P()|$TOOL=T1|$BASE=B1|LIN XP1|$BASE=B2|LIN XP1|END", "E0904 6"),
    ("DEF P()|$TOOL=T1|$BASE=B1|LIN_REL {Z 50}|END", "W0905@4"),
    ("DEF P()|$TOOL=T1|$BASE=B1|XP1.Z=5|LIN XP1|END", "E0903 5"),
    ("DEF P()|$TOOL=T1|$BASE=B1|LIN XOTHER|END", "W0905@4"),
];

#[test]
fn krl_frames() {
    check(KRL, of_krl);
}

/// `PT` is a robtarget, `QQ` a jointtarget, `t1`, `t2`, `w1`, `w2` are tools and work objects. After the frames: `q` if the
/// configuration of the point selects the branch, `n` for the branch next to the position before.
fn of_rapid(source: &str) -> String {
    let pose = |x: usize, z: usize| format!("[[{x},0,{z}],[1,0,0,0]]");
    let mut head = "MODULE M ".to_owned();
    for n in 1..=2 {
        head += &format!("PERS tooldata t{n}:=[TRUE,{},[1,[0,0,1],[1,0,0,0],0,0,0]];", pose(0, 100 * n));
        let (user, object) = (pose(1000 * n, 0), pose(0, 0));
        head += &format!("PERS wobjdata w{n}:=[FALSE,TRUE,\"\",{user},{object}];");
        head += &format!("CONST robtarget p{n}:=PT;VAR num n{n}:=0;");
    }
    let text = format!("{head}|{source}|ENDMODULE").replace('|', "\n");
    let text = text.replace("PT", "[[900,0,900],[0,1,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]]");
    let text = text.replace("QQ", "[[0,0,0,0,30,0],[9E9,9E9,9E9,9E9,9E9,9E9]]");
    let text = Text { file: "M.mod", text: &text };
    match rapid::read(text, None) {
        Err(wrong) => refusal(&wrong),
        Ok(read) => {
            let points = read.points.iter().map(|point| {
                let branch = match (&point.frames, point.branch) {
                    (None, _) => "",
                    (_, Branch::ByQuadrants(_)) => "q",
                    (
                        _,
                        Branch::Nearest
                        | Branch::NearestElse(_)
                        | Branch::NearestTo(_)
                        | Branch::ByStatusAndTurn,
                    ) => "n",
                    (_, Branch::ByFanuc(_) | Branch::OnLine(_)) => "?",
                };
                (text.line(point.first_use.start), numbers(point.frames.as_ref()) + branch)
            });
            answer(points.collect(), read.not_corrected.iter().chain(&read.warnings).cloned())
        }
    }
}

const RAPID: &[(&str, &str)] = &[
    // The frames are in the statement.
    ("PROC main()|MoveL PT,v100,fine,t1;|ENDPROC", "3=1/0n"),
    ("PROC main()|MoveJ PT,v100,fine,t1\\WObj:=w2;|ENDPROC", "3=1/2q"),
    ("PROC main()|MoveL PT,v100,fine,t1\\WObj:=w1;|MoveL PT,v100,z10,t2\\WObj:=w2;|ENDPROC", "3=1/1n 4=2/2n"),
    ("PROC main()|MoveAbsJ QQ,v100,fine,t1;|ENDPROC", "3=axes"),
    ("PROC main()|MoveC PT,PT,v100,fine,tool0;|ENDPROC", "3=0/0n 3=0/0n"),
    ("PROC main()|MoveL p1,v100,fine,t1;|MoveL p1,v100,fine,t2;|ENDPROC", "E0904 4"),
    ("PROC main()|MoveL PT,v100,fine,tOther;|ENDPROC", "E0901 3"),
    // Data that the program changes.
    ("PROC main()|t1:=t2;|MoveL PT,v100,fine,t1;|ENDPROC", "4=2/0n"),
    ("PROC main()|t1:=f();|MoveL PT,v100,fine,t1;|ENDPROC", "E0901 4"),
    ("PROC main()|IF n1=1 THEN|t1:=t2;|ENDIF|MoveL PT,v100,fine,t1;|ENDPROC", "E0901 6"),
    ("PROC main()|IF n1=1 THEN|t1:=t2;|ELSE|t1:=t2;|ENDIF|MoveL PT,v100,fine,t1;|ENDPROC", "8=2/0n"),
    ("PROC main()|t1:=t2;|s;|MoveL PT,v100,fine,t1;|ENDPROC|PROC s()|t1:=f();|ENDPROC", "E0901 5"),
    ("PROC main()|s;|MoveL PT,v100,fine,t1;|ENDPROC|PROC s()|t1:=t2;|ENDPROC", "4=2/0n"),
    ("PROC main()|t1:=t2;|MoveL PT,v100,fine,t1;|ENDPROC|TRAP s|t1:=f();|ENDTRAP", "E0901 4"),
    ("PROC main()|t1:=t2;|%\"s\"+ValToStr(n1)%;|MoveL PT,v100,fine,t1;|ENDPROC", "E0901 5"),
    ("PROC main()|t1:=t2;|CallByVar \"s\",n1;|MoveL PT,v100,fine,t1;|ENDPROC", "E0901 5"),
    (
        "PROC main()|t1:=t2;|s t1;|ENDPROC|PROC s(INOUT tooldata t)|t:=f();|MoveL PT,v100,fine,t1;|ENDPROC",
        "E0901 8",
    ),
    ("PROC main()|p1:=PT;|MoveL p1,v100,fine,t1;|ENDPROC", "4=1/0n"),
    ("PROC main()|p1:=p2;|MoveL p1,v100,fine,t1;|ENDPROC", "4=1/0n"),
    ("PROC main()|MoveL PT,v100,fine,t1;|t1:=t2;|ENDPROC", "E0901 3"),
    ("PROC main()|t1.tframe.trans.z:=200;|MoveL PT,v100,fine,t1;|ENDPROC", "4=2/0n"),
    ("PROC main()|t1.tframe.trans:=[0,0,200];|MoveL PT,v100,fine,t1;|ENDPROC", "4=2/0n"),
    ("PROC main()|t1.tframe:=[[0,0,200],[1,0,0,0]];|MoveL PT,v100,fine,t1;|ENDPROC", "4=2/0n"),
    ("PROC main()|t1.tframe.trans.z:=f();|MoveL PT,v100,fine,t1;|ENDPROC", "E0901 4"),
    ("PROC main()|t1.tload.mass:=f();|MoveL PT,v100,fine,t1;|ENDPROC", "4=1/0n"),
    ("PROC main()|MoveL PT,v100,fine,t1;|t1.tframe.trans.z:=200;|ENDPROC", "E0901 3"),
    ("PROC main()|t1.tframe.trans.y:=0;|MoveL PT,v100,fine,t1;|t1.tframe.trans.z:=f();|ENDPROC", "E0901 4"),
    ("PROC main()|t1.other:=5;|MoveL PT,v100,fine,t1;|ENDPROC", "E0901 4"),
    ("PROC main()|t1.tframe.trans.z:=5;|MoveL PT,v100,fine,t2;|ENDPROC", "4=2/0n"),
    ("PROC main()|w1.uframe.trans:=[2000,0,0];|MoveL PT,v100,fine,t1\\WObj:=w1;|ENDPROC", "4=1/2n"),
    ("PROC main()|w1.oframe.trans:=[f(),0,0];|MoveL PT,v100,fine,t1\\WObj:=w1;|ENDPROC", "E0901 4"),
    ("PROC main()|MoveL PT,v100,fine,t1;|ENDPROC|PROC s()|t1:=t2;|ENDPROC", "E0901 3"),
    ("PROC main()|MoveL PT,v100,fine,t1;|ENDPROC|FUNC num f()|t1:=t2;|RETURN 1;|ENDFUNC", "E0901 3"),
    ("PROC main()|MToolTCPCalib QQ,QQ,QQ,QQ,t1,n1,n2;|MoveL PT,v100,fine,t1;|ENDPROC", "E0901 4"),
    ("PROC main()|MToolRotCalib QQ,QQ,t1;|MoveL PT,v100,fine,t1;|ENDPROC", "E0901 4"),
    (
        "PROC main()|SToolTCPCalib PT,PT,PT,PT,t1,n1,n2;|MoveL PT,v100,fine,t2;|ENDPROC",
        "4=2/0n W0905@3 W0905@3 W0905@3 W0905@3",
    ),
    (
        "PROC main()|set t1;|MoveL PT,v100,fine,t1;|ENDPROC|PROC set(INOUT tooldata t)|t:=t2;|ENDPROC",
        "E0901 4",
    ),
    ("PROC main()|use t1;|MoveL PT,v100,fine,t1;|ENDPROC|PROC use(tooldata t)|n1:=1;|ENDPROC", "4=1/0n"),
    ("PROC main()|pick t1;|MoveL PT,v100,fine,t1;|ENDPROC", "4=1/0n W0921@3"),
    ("PROC main()|pick t1;|MoveL PT,v100,fine,t2;|ENDPROC", "4=2/0n"),
    ("PROC main()|p1.trans.z:=5;|MoveL p1,v100,fine,t1;|ENDPROC", "E0903 4"),
    ("PROC main()|p1:=CRobT();|MoveL p1,v100,fine,t1;|ENDPROC", "E0903 4"),
    ("PROC main()|MoveL Offs(p1,0,0,5),v100,fine,t1;|ENDPROC", "W0905@3"),
    (
        "PROC main()|MoveL [[n1,0,900],[0,1,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v100,fine,t1;|ENDPROC",
        "W0905@3",
    ),
    ("PROC main()|TriggL Offs(p1,0,0,5),v100,n1,fine,t1;|ENDPROC", "W0905@3"),
    // Parameters and variables of routines hide the data of the module.
    ("PROC main()|go p1;|ENDPROC|PROC go(robtarget p2)|MoveL p2,v100,fine,t1;|ENDPROC", "6=1/0n"),
    (
        "PROC main()|go PT,t2;|ENDPROC|PROC go(robtarget p,PERS tooldata t)|MoveL p,v100,fine,t;|ENDPROC",
        "6=2/0n",
    ),
    (
        "PROC main()|a t1;|MoveL PT,v100,fine,t1;|ENDPROC|PROC a(PERS tooldata t)|b t;|ENDPROC|PROC b(INOUT tooldata u)|u:=t2;|ENDPROC",
        "E0901 4",
    ),
    ("PROC main()|go PT,t2;|ENDPROC|PROC go(robtarget p,tooldata t)|MoveL p,v100,fine,t;|ENDPROC", "6=2/0n"),
    (
        "PROC main()|go PT\\w:=w2;|ENDPROC|PROC go(robtarget p\\wobjdata w)|MoveL p,v100,fine,t1\\WObj:=w;|ENDPROC",
        "6=1/2n",
    ),
    ("PROC main()|CONST robtarget p1:=PT;|MoveL p1,v100,fine,t1;|ENDPROC", "4=1/0n"),
    ("PROC main()|VAR robtarget p1;|MoveL p1,v100,fine,t1;|ENDPROC", "W0905@4"),
    ("PROC main()|VAR robtarget p9:=PT;|p9.trans.z:=5;|MoveL p9,v100,fine,t1;|ENDPROC", "W0905@5"),
    (
        "PROC main()|VAR robtarget p9:=PT;|IF n1=1 THEN|p9:=PT;|ENDIF|MoveL p9,v100,fine,t1;|ENDPROC",
        "W0905@7",
    ),
    ("PROC main()|VAR robtarget p9;|p9:=PT;|MoveL p9,v100,fine,t1;|ENDPROC", "5=1/0n"),
    ("PROC go(robtarget p)|MoveL p,v100,fine,t1;|ENDPROC", "W0905@3"),
    // Program displacement.
    ("PROC main()|PDispSet d1;|MoveL PT,v100,fine,t1;|ENDPROC", "E0901 4"),
    ("PROC main()|PDispOn PT,t1;|MoveL PT,v100,fine,t1;|PDispOff;|ENDPROC", "E0901 4"),
    ("PROC main()|PDispSet d1;|PDispOff;|MoveL PT,v100,fine,t1;|ENDPROC", "5=1/0n"),
    ("PROC main()|MoveL PT,v100,fine,t1;|PDispSet d1;|ENDPROC", "3=1/0n"),
    ("PROC main()|PDispSet d1;|MoveAbsJ QQ,v100,fine,t1;|ENDPROC", "4=axes"),
    ("PROC main()|EOffsSet e1;|MoveL PT,v100,fine,t1;|ENDPROC", "E0901 4"),
    ("PROC main()|EOffsOn \\ExeP:=p1,p2;|EOffsOff;|MoveL PT,v100,fine,t1;|ENDPROC", "5=1/0n W0905@3 W0905@3"),
    ("PROC main()|IF n1=1 PDispSet d1;|MoveL PT,v100,fine,t1;|ENDPROC", "E0901 4"),
    ("PROC main()|IF n1=1 THEN|PDispSet d1;|ENDIF|MoveL PT,v100,fine,t1;|ENDPROC", "E0901 6"),
    ("PROC main()|FOR i FROM 1 TO 3 DO|MoveL PT,v100,fine,t1;|PDispSet d1;|ENDFOR|ENDPROC", "E0901 4"),
    ("PROC main()|WHILE n1=1 DO|MoveL PT,v100,fine,t1;|PDispSet d1;|PDispOff;|ENDWHILE|ENDPROC", "4=1/0n"),
    (
        "PROC main()|TEST n1|CASE 1:|PDispSet d1;|DEFAULT:|PDispSet d1;|ENDTEST|PDispOff;|MoveL PT,v100,fine,t1;|ENDPROC",
        "10=1/0n",
    ),
    ("PROC main()|GOTO over;|PDispSet d1;|over:|MoveL PT,v100,fine,t1;|ENDPROC", "6=1/0n"),
    ("PROC main()|again:|MoveL PT,v100,fine,t1;|PDispSet d1;|GOTO again;|ENDPROC", "E0901 4"),
    ("PROC main()|s;|MoveL PT,v100,fine,t1;|ENDPROC|PROC s()|PDispSet d1;|ENDPROC", "E0901 4"),
    (
        "PROC main()|n1:=f(1);|MoveL PT,v100,fine,t1;|ENDPROC|FUNC num f(num x)|PDispSet d1;|RETURN x;|ENDFUNC",
        "E0901 4",
    ),
    ("PROC main()|PDispSet d1;|s;|ENDPROC|PROC s()|MoveL PT,v100,fine,t1;|ENDPROC", "E0901 7"),
    ("PROC main()|MoveL PT,v100,fine,t1;|ENDPROC|TRAP t|PDispSet d1;|ENDTRAP", "E0901 3"),
    ("PROC main()|s;|MoveL PT,v100,fine,t1;|ERROR|PDispSet d1;|TRYNEXT;|ENDPROC", "E0901 4"),
    ("PROC main()|MoveL PT,v100,fine,t1;|s;|ERROR|PDispSet d1;|RETURN;|ENDPROC", "3=1/0n"),
    // The configuration of MoveJ.
    ("PROC main()|ConfJ\\Off;|MoveJ PT,v100,fine,t1;|ENDPROC", "4=1/0n"),
    ("PROC main()|ConfJ\\Off;|ConfJ\\On;|MoveJ PT,v100,fine,t1;|ENDPROC", "5=1/0q"),
    (
        "PROC main()|ConfJ \\Off;|MoveJ PT,v100,fine,t1;|ConfJ \\On;|MoveJ PT,v100,fine,t1;|ENDPROC",
        "4=1/0n 6=1/0q",
    ),
    (
        "PROC main()|init;|MoveJ PT,v100,fine,t1;|ENDPROC|PROC init()|ConfJ\\Off;|ConfL\\Off;|ENDPROC",
        "4=1/0n",
    ),
    ("PROC main()|IF n1=1 ConfJ\\Off;|MoveJ PT,v100,fine,t1;|ENDPROC", "E0901 4"),
    ("PROC main()|IF n1=1 THEN|ConfJ\\Off;|ENDIF|MoveL PT,v100,fine,t1;|ENDPROC", "6=1/0n"),
    ("PROC main()|ConfL\\Off;|MoveL PT,v100,fine,t1;|ENDPROC", "4=1/0n"),
    // Motions to which no way leads, and those of functions.
    ("PROC main()|RETURN;|MoveL PT,v100,fine,t1;|ENDPROC", "W0905@4"),
    ("FUNC num f()|MoveL PT,v100,fine,t1;|RETURN 1;|ENDFUNC|PROC main()|n1:=f();|ENDPROC", "3=1/0n"),
    ("PROC main()|n1:=1;|ENDPROC|PROC s()|MoveL PT,v100,fine,t1;|ENDPROC", "6=1/0n"),
];

#[test]
fn rapid_frames() {
    check(RAPID, of_rapid);
}

/// A controller's file with the frames 1 and 2.
fn sysframe() -> String {
    let entry = |n: usize, x: usize, z: usize| {
        format!(
            "     [1,{n}] =\n  Group: 1   Config: N D B, 0, 0, 0\n  X:  {x}.000   Y:     0.000   Z:  {z}.000\n  W:     0.000   P:     0.000   R:     0.000\n"
        )
    };
    let array = |name: &str, entries: [String; 2]| {
        format!(
            "[*SYSTEM*]${name}  Storage: SHADOW  Access: RW  : ARRAY[1,9] OF POSITION\n{}",
            entries.concat()
        )
    };
    array("MNUFRAME", [entry(1, 1000, 0), entry(2, 2000, 0)])
        + &array("MNUTOOL", [entry(1, 0, 100), entry(2, 0, 200)])
}

/// A listing in which the first statement is in line 3; `@L` and `@J` are a speed with an exact stop. Positions: 1 and 2 of
/// the frames 1, 3 of the frames 2, 4 and 6 of the frames that are selected, 5 axis angles, 7 a tool 3, 8 not taught, 10 and 11
/// with a second group, 12 without a configuration. After the frames: `q` if the configuration with its turns selects the
/// branch, `l` the one on a line, `n` for the branch next to the position before.
fn of_fanuc(source: &str, given: GivenFrames<'_>) -> String {
    let position =
        |n: usize, frames: &str, rest: &str| format!("P[{n}]{{\n   GP1:\n\tUF : {frames},{rest}\n}};\n");
    let pose = "\t\tCONFIG : 'N U T, 0, 0, 0',\n\tX =  1.000  mm,\tY =  2.000  mm,\tZ =  3.000  mm,\n\tW =  .000 deg,\tP = -.500 deg,\tR = 0.000 deg";
    let second = |at: usize| format!("{pose}\n   GP2:\n\tUF : 1, UT : 1,\t\n\tJ1=  {at}.000 deg");
    let joint = "\t\n\tJ1=  1.000 deg,\tJ2=  2.000 deg,\tJ3=  3.000 deg,\n\tJ4=  4.000 deg,\tJ5=  -5.000 deg,\tJ6=  6.000 deg";
    let positions = [
        position(1, "1, UT : 1", pose),
        position(2, "1, UT : 1", pose),
        position(3, "2, UT : 2", pose),
        position(4, "F, UT : F", pose),
        position(5, "1, UT : 1", joint),
        position(6, "F, UT : F", pose),
        position(7, "0, UT : 0", &pose.replace(" 1.000", " 0.000").replace(" 3.000", " 300.000")),
        position(8, "1, UT : 1", &pose.replace("2.000", "********")),
        position(10, "1, UT : 1", &second(10)),
        position(11, "1, UT : 1", &second(11)),
        position(12, "1, UT : 1", &pose.replace("\t\tCONFIG : 'N U T, 0, 0, 0',", "")),
    ];
    let lines: String = source.split('|').zip(1..).map(|(line, n)| format!("{n:4}:  {line} ;\n")).collect();
    let lines = lines.replace("@L", "100mm/sec FINE").replace("@J", "50% FINE");
    let text = format!("/PROG  P\n/MN\n{lines}/POS\n{}/END\n", positions.concat());
    let text = Text { file: "P.LS", text: &text };
    match fanuc::read(text, given) {
        Err(wrong) => refusal(&wrong),
        Ok(read) => {
            let points = read.points.iter().map(|point| {
                let branch = match (&point.frames, point.branch) {
                    (None, _) => "",
                    (_, Branch::ByFanuc(_)) => "q",
                    (_, Branch::OnLine(_)) => "l",
                    (_, Branch::Nearest | Branch::NearestTo(_)) => "n",
                    (_, Branch::ByQuadrants(_) | Branch::NearestElse(_) | Branch::ByStatusAndTurn) => "?",
                };
                (text.line(point.first_use.start), numbers(point.frames.as_ref()) + branch)
            });
            answer(points.collect(), read.not_corrected.iter().chain(&read.warnings).cloned())
        }
    }
}

const FANUC: &[(&str, &str)] = &[
    // A position names its frames, and the controller stops where others are selected.
    ("L P[1] @L", "3=1/1l"),
    ("J P[1] @J", "3=1/1q"),
    ("J P[5] @J", "3=axes"),
    ("C P[1] P[2] @L", "3=1/1l 3=1/1l"),
    ("C P[1]\n    :  P[2] @L", "3=1/1l 3=1/1l"),
    ("UFRAME_NUM=1|UTOOL_NUM=1|L P[1] @L", "5=1/1l"),
    ("UFRAME_NUM=2|UTOOL_NUM=1|L P[1] @L", "E0902 5"),
    ("UFRAME_NUM=1|UTOOL_NUM=2|L P[1] @L", "E0902 5"),
    ("UTOOL_NUM=2|J P[5] @J", "4=axes"),
    ("L P[1] @L|L P[3] @L", "3=1/1l 4=2/2l"),
    ("L P[1] @L|L P[1] @L", "3=1/1l"),
    ("!L P[3] @L|L P[1] @L", "4=1/1l"),
    ("J P[1:above part] 50% CNT100", "3=1/1q"),
    // One of the frames that are selected.
    ("L P[4] @L", "E0901 3"),
    ("UFRAME_NUM=2|UTOOL_NUM=1|L P[4] @L", "5=1/2l"),
    ("UFRAME_NUM=2|L P[4] @L", "E0901 4"),
    ("UFRAME_NUM=0|UTOOL_NUM=0|L P[4] @L", "5=0/0l"),
    ("UFRAME_NUM=1|UTOOL_NUM=1|L P[4] @L|UFRAME_NUM=2|L P[4] @L", "E0904 7"),
    ("UFRAME_NUM=1|UTOOL_NUM=1|L P[4] @L|UFRAME_NUM=2|L P[6] @L", "5=1/1l 7=1/2l"),
    ("UFRAME_NUM=R[1]|UTOOL_NUM=1|L P[4] @L", "E0901 5"),
    ("R[1:user frame]=2|UFRAME_NUM=R[1:user frame]|UTOOL_NUM=1|L P[4] @L", "6=1/2l"),
    ("R[1]=2|R[1]=R[1]+1|UFRAME_NUM=R[1]|UTOOL_NUM=1|L P[4] @L", "E0901 7"),
    ("UFRAME_NUM=AR[1]|UTOOL_NUM=1|L P[1] @L", "E0901 5"),
    ("UFRAME_NUM=9|UTOOL_NUM=1|L P[4] @L", "E0901 5"),
    ("$MNUFRAMENUM[1]=2|UTOOL_NUM=1|L P[4] @L", "E0901 5"),
    ("$WAITTMOUT=200|UTOOL_NUM=1|UFRAME_NUM=1|L P[4] @L", "6=1/1l"),
    // Choices.
    ("UFRAME_NUM=1|UTOOL_NUM=1|IF R[1]=1,JMP LBL[1]|UFRAME_NUM=2|LBL[1]|L P[4] @L", "E0901 8"),
    ("UFRAME_NUM=1|UTOOL_NUM=1|IF R[1]=1,JMP LBL[1]|UFRAME_NUM=1|LBL[1]|L P[4] @L", "8=1/1l"),
    ("UTOOL_NUM=1|IF (R[1]=1) THEN|UFRAME_NUM=1|ELSE|UFRAME_NUM=2|ENDIF|L P[4] @L", "E0901 9"),
    ("UTOOL_NUM=1|IF (R[1]=1) THEN|UFRAME_NUM=1|ELSE|UFRAME_NUM=1|ENDIF|L P[4] @L", "9=1/1l"),
    ("UFRAME_NUM=1|UTOOL_NUM=1|IF (!DI[1] AND R[1]=1),UFRAME_NUM=(2)|L P[4] @L", "E0901 6"),
    (
        "UTOOL_NUM=1|SELECT R[1]=1,JMP LBL[1]|=2,JMP LBL[2]|ELSE,JMP LBL[3]|LBL[1]|UFRAME_NUM=1|JMP LBL[9]|LBL[2]|\
         UFRAME_NUM=1|JMP LBL[9]|LBL[3]|UFRAME_NUM=1|LBL[9]|L P[4] @L",
        "16=1/1l",
    ),
    (
        "UTOOL_NUM=1|SELECT R[1]=1,JMP LBL[1]|=2,JMP LBL[2]|ELSE,JMP LBL[3]|LBL[1]|UFRAME_NUM=1|JMP LBL[9]|LBL[2]|\
         UFRAME_NUM=2|JMP LBL[9]|LBL[3]|UFRAME_NUM=1|LBL[9]|L P[4] @L",
        "E0901 16",
    ),
    ("UTOOL_NUM=1|UFRAME_NUM=1|SELECT R[1]=1,CALL A|ELSE,CALL B|L P[4] @L", "7=1/1l W0921@7 W0921@7"),
    ("UTOOL_NUM=1|UFRAME_NUM=1|WAIT DI[1]=ON,TIMEOUT,LBL[1]|UFRAME_NUM=2|LBL[1]|L P[4] @L", "E0901 8"),
    ("UTOOL_NUM=1|UFRAME_NUM=1|L P[4] @L Skip,LBL[1]|UFRAME_NUM=2|LBL[1]|L P[6] @L", "5=1/1l W0905@8"),
    ("UTOOL_NUM=1|UFRAME_NUM=1|L P[4] @L Skip,LBL[1],PR[9]=LPOS|LBL[1]|L P[6] @L", "5=1/1l 7=1/1l"),
    // Loops and jumps.
    ("UFRAME_NUM=1|UTOOL_NUM=1|LBL[1]|L P[4] @L|UFRAME_NUM=2|JMP LBL[1]", "E0901 6"),
    ("UFRAME_NUM=1|UTOOL_NUM=1|LBL[1]|L P[4] @L|UFRAME_NUM=1|JMP LBL[1]", "6=1/1l"),
    (
        "UTOOL_NUM=1|LBL[1]|UFRAME_NUM=1|L P[4] @L|UFRAME_NUM=2|IF R[1]<3,JMP LBL[1]|L P[6] @L",
        "6=1/1l 9=1/2l",
    ),
    ("UTOOL_NUM=1|UFRAME_NUM=1|FOR R[1]=1 TO 3|L P[4] @L|UFRAME_NUM=2|ENDFOR", "E0901 6"),
    ("UTOOL_NUM=1|UFRAME_NUM=1|FOR R[1]=1 TO 3|UFRAME_NUM=2|ENDFOR|L P[4] @L", "E0901 8"),
    ("UTOOL_NUM=1|UFRAME_NUM=1|END|UFRAME_NUM=2|L P[4] @L", "W0905@7"),
    ("UTOOL_NUM=1|UFRAME_NUM=1|JMP LBL[2]|UFRAME_NUM=2|LBL[2:over]|L P[4] @L", "8=1/1l"),
    ("UTOOL_NUM=1|UFRAME_NUM=1|JMP LBL[R[1]]|LBL[1]|UFRAME_NUM=2|LBL[2]|L P[4] @L", "E0901 9"),
    // Programs of other files.
    ("UTOOL_NUM=1|UFRAME_NUM=1|CALL A|L P[4] @L", "6=1/1l W0921@6 W0921@6"),
    ("UTOOL_NUM=1|UFRAME_NUM=1|RUN A|L P[4] @L", "6=1/1l W0921@6 W0921@6"),
    ("UTOOL_NUM=1|CALL A|UFRAME_NUM=1|L P[4] @L", "6=1/1l W0921@6"),
    ("CALL A|UTOOL_NUM=1|UFRAME_NUM=1|L P[4] @L", "6=1/1l"),
    ("UTOOL_NUM=1|UFRAME_NUM=1|CALL A(1,'b')|L P[1] @L", "6=1/1l"),
    ("UTOOL_NUM=1|UFRAME_NUM=2|CALL A|L P[1] @L", "6=1/1l"),
    ("PR[1]=P[7]|UTOOL[1]=PR[1]|CALL A|UTOOL_NUM=1|UFRAME_NUM=1|L P[4] @L", "E0901 8"),
    // Frames that the program defines.
    ("PR[1]=P[7]|UTOOL[1]=PR[1]|UTOOL_NUM=1|UFRAME_NUM=1|L P[4] @L", "7=3/1l"),
    ("PR[1]=P[7]|UTOOL[1]=PR[1]|L P[1] @L", "5=3/1l"),
    ("PR[1]=P[7]|PR[1,3]=5|UTOOL[1]=PR[1]|UTOOL_NUM=1|UFRAME_NUM=1|L P[4] @L", "E0901 8"),
    ("UTOOL[1]=PR[3]|UTOOL_NUM=1|UFRAME_NUM=1|L P[4] @L", "E0901 6"),
    ("UTOOL[2]=PR[3]|UTOOL_NUM=1|UFRAME_NUM=1|L P[4] @L", "6=1/1l"),
    ("UTOOL[R[1]]=PR[3]|UTOOL_NUM=1|UFRAME_NUM=1|L P[4] @L", "E0901 6"),
    ("UTOOL_NUM=1|UFRAME_NUM=1|$MNUTOOL[1,1]=PR[1]|L P[4] @L", "E0901 6"),
    ("L P[1] @L|UTOOL[1]=PR[3]", "3=1/1l"),
    // Position registers: the frames that are selected apply.
    ("UTOOL_NUM=1|UFRAME_NUM=2|L PR[1] @L", "W0905@5"),
    ("UTOOL_NUM=1|UFRAME_NUM=2|PR[1]=P[1]|L PR[1] @L", "6=1/2l"),
    ("UTOOL_NUM=1|UFRAME_NUM=1|PR[1]=P[1]|L PR[1] @L|L P[1] @L", "6=1/1l"),
    ("UTOOL_NUM=1|UFRAME_NUM=2|PR[1]=P[1]|L PR[1] @L|UFRAME_NUM=1|L P[1] @L", "E0904 8"),
    ("UTOOL_NUM=1|UFRAME_NUM=2|PR[1]=P[1]|PR[1,3]=PR[1,3]+40|L PR[1] @L", "W0905@5 W0905@7"),
    ("UTOOL_NUM=1|UFRAME_NUM=2|PR[1]=P[1]|PR[GP1:1,3]=5|L PR[1] @L", "W0905@5 W0905@7"),
    ("PR[1]=P[1]|R[1]=1|PR[R[1]]=PR[2]|UTOOL_NUM=1|UFRAME_NUM=1|L PR[1] @L", "W0905@3 W0905@8"),
    ("PR[1]=P[1]|CALL A", "W0905@3"),
    ("UTOOL_NUM=1|UFRAME_NUM=1|PR[1]=LPOS|L PR[1] @L", "W0905@6"),
    ("UTOOL_NUM=1|UFRAME_NUM=1|L PR[R[1]] @L", "W0905@5"),
    ("UTOOL_NUM=1|UFRAME_NUM=1|L P[R[1]] @L", "W0905@5"),
    ("L P[1] @L|P[1,3]=5|L P[1] @L", "3=1/1l W0905@5"),
    // Options.
    ("L P[1] @L INC", "W0905@3"),
    ("L P[1] @L Offset,PR[1]", "E0901 3"),
    ("OFFSET CONDITION PR[1]|L P[1] @L Offset", "E0901 4"),
    ("OFFSET CONDITION PR[1]|L P[1] @L", "4=1/1l"),
    ("L P[1] @L Tool_Offset,PR[1]", "E0901 3"),
    ("TOOL_OFFSET CONDITION PR[1]|L P[1] @L Tool_Offset", "E0901 4"),
    ("L P[1] @L ACC80 Offset,PR[1:shift]", "E0901 3"),
    ("L P[1] @L ACC R[7] Offset,PR[1]", "E0901 3"),
    ("L P[1] @L EV50% Offset", "E0901 3"),
    ("L P[1] @L TB .50sec,DO[1]=ON Offset", "E0901 3"),
    ("J P[5] @J Offset,PR[1]", "E0901 3"),
    ("L P[1] @L VOFFSET,VR[1]", "E0901 3"),
    ("L P[1] @L COORD", "E0901 3"),
    ("L P[1] @L COORD[2]", "E0901 3"),
    ("L P[1] @L RTCP", "E0901 3"),
    ("L P[1] @L TRACK", "E0901 3"),
    ("L P[1] @L ACC80 Wjnt PTH", "3=1/1l"),
    ("L P[1] @L TB .50sec,DO[1]=ON", "3=1/1l"),
    ("L P[1] @L TA 0.50sec,CALL A", "3=1/1l"),
    ("L P[1] R[5:speed]mm/sec CNT R[6] ACC R[7] EV50%", "3=1/1l"),
    ("L P[1] WELD_SPEED FINE", "3=1/1l"),
    // What is not read, and positions that are none.
    ("A P[1] @L", "W0905@3"),
    ("L P[1] 100mm/sec", "W0905@3"),
    ("L P[9] @L", "W0905@3"),
    ("L P[8] @L", "W0905@3"),
    ("J P[12] @J", "E0923 3"),
    ("L P[12] @L", "3=1/1n"),
    ("L P[10] @L|L P[11] @L", "3=1/1l 4=1/1l W0916@3"),
    ("~ # \"|L P[1] @L", "4=1/1l"),
];

#[test]
fn fanuc_frames() {
    let sysframe = sysframe();
    let config = Some(Text { file: "SYSFRAME.VA", text: &sysframe });
    check(FANUC, |source| of_fanuc(source, GivenFrames { config, ..GivenFrames::default() }));
}

/// With the tool `T1` and the base `B1` of the user, which stand for one number each.
const FANUC_GIVEN: &[(&str, &str)] = &[
    ("L P[1] @L", "3=1/1l"),
    ("L P[3] @L", "3=1/1l"),
    ("L P[1] @L|L P[3] @L", "E0902 4"),
    ("UFRAME_NUM=0|UTOOL_NUM=2|L P[4] @L", "5=1/0l"),
];

#[test]
fn fanuc_frames_of_the_user() {
    let pose = |x: f64, z: f64| Some(Pose::from_xyzabc([x, 0.0, z, 0.0, 0.0, 0.0]));
    let given = GivenFrames { config: None, tool: pose(0.0, 100.0), base: pose(1000.0, 0.0) };
    check(FANUC_GIVEN, |source| of_fanuc(source, given));
    let none = |source: &str| of_fanuc(source, GivenFrames::default());
    assert_eq!(none("L P[1] @L"), "E0901 3");
    assert_eq!(none("J P[5] @J"), "3=axes");
}

/// The finding about ways that differ names both lines.
#[test]
fn refusals_name_both_lines() {
    let source = "def f():\n  set_tcp(p[0,0,0.1,0,0,0])\n  if a():\n    set_tcp(p[0,0,0.2,0,0,0])\n  end\n  movel(p[0.5,0.1,0.3,0,3.14,0])\nend\n";
    let wrong = urscript::read(Text { file: "P.script", text: source }, None).unwrap_err();
    let text = wrong.to_string();
    assert!(text.contains("of line 2") && text.contains("of line 4"), "{text}");
    let expected = CompensationFinding::FrameMixed {
        frame: "the tool",
        first: "of line 2".into(),
        second: "of line 4".into(),
    };
    assert!(text.contains(&expected.to_string()), "{text}");
}

/// A word that a language does not have is named with that language.
#[test]
fn findings_name_the_language_of_the_file() {
    let script = urscript::read(Text { file: "P.script", text: "def f():\n  x = 1 ~ 2\nend\n" }, None);
    assert!(script.unwrap_err().to_string().contains("URScript"));
    let module = rapid::read(Text { file: "M.mod", text: "MODULE M\n~\nENDMODULE\n" }, None);
    assert!(module.unwrap_err().to_string().contains("RAPID"));
}
