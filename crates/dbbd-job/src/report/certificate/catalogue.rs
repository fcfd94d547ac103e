//! The certificate of a calibration.

use dbbd_model::diagnostic::Names;
use dbbd_model::findings;

findings! {
    /// What a certificate refuses, warns of or leaves empty.
    CertificateFinding "Certificates" {
        E2001 "a certificate cannot be made from a file",
        cause: "The file is not the result.json of `dbbd identify`, is not complete, or is of a version that did not compute an uncertainty budget.",
        cure: "Give result.json or the directory that holds it. Identify again from the lengths of an older result." {
            NoResult { why: String } => "is not a result: {why}";
            NoBudget => "has no uncertainty budget: an earlier version wrote it";
        }
        E2002 "a check cannot be stated in a certificate",
        cause: "The file is not the check.json of `dbbd check`, or it is the check of another robot or of another calibration.",
        cure: "Give the check.json of this robot and this result." {
            NoCheck { why: String } => "is not a check: {why}";
            CheckOfAnother { robot: String, checked: String } => "is of `{checked}`, the result is of `{robot}`";
            CheckOfOtherResult { lengths: String } => "is the check of another calibration: the result was identified from {lengths}, and what was checked was not";
            CheckOfOtherFile { robot: String } => "is the check of another calibration: {robot} of the result was not checked";
        }
        I2003 "this build writes no PDF",
        cause: "dbbd was built without the feature `pdf`.",
        cure: "Print certificate.html from a browser, or build dbbd with the feature `pdf`." {
            NoPdf => "certificate.pdf is not written: this build has no PDF";
        }
        I2004 "a certificate has empty fields",
        cause: "A certificate states these, and neither job, capture nor the file of the identity does. The draft says `not stated`; a DCC, which needs a date, has 0001-01-01.",
        cure: "State them in [identity] of the job or in the file of the identity; docs/reference/files.md has the keys.",
        asks: [Identity] {
            NotStated { what: Names } => "not stated: {what}";
        }
        W2005 "a certificate of a result with warnings",
        cause: "The result or its check has warnings, or the estimate did not converge.",
        cure: "Resolve the warnings first; `report.html` and `check.html` show them." {
            WithWarnings { warnings: usize } => "the result and its check have {warnings} warnings; the certificate lists them";
        }
        W2007 "an identity contradicts the result",
        cause: "The file of the identity states another robot, controller, load, day, bar, certificate of the bar, ball or temperature than the result carries, or a base ball that the measurement has not. The certificate states what the file states; the numbers are those of the measurement.",
        cure: "Correct the file of the identity, or identify again with the right job.",
        asks: [Identity] {
            OtherThanCarried { key: String, carried: String, stated: String } => "{key} is stated as {stated}; the result has {carried}";
            NoSuchBall { ball: String, balls: usize } => "a serial number is stated of base ball {ball}, and {balls} were measured";
        }
        E2008 "a certificate of simulated readings",
        cause: "The result, or the check that is added, was computed from readings of the virtual bar of dbbd. A certificate of them would state the calibration of a robot that nobody measured.",
        cure: "Measure the robot. To see how a certificate looks, make a specimen.",
        asks: [Specimen] {
            OfSimulated => "the readings are simulated: no certificate is made of them",
                help: "a specimen shows how a certificate looks";
        }
        E2006 "the PDF cannot be made",
        cause: "The text has a character that the PDF's font lacks, or a fault of dbbd.",
        cure: "Use letters of European scripts in [identity], or print certificate.html." {
            PdfFailed { why: String } => "certificate.pdf cannot be made: {why}";
        }
    }
}
