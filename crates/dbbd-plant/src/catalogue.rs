//! The archive: runs of many cells in a database and an object store.

use dbbd_model::findings;

findings! {
    /// What the archive refuses, or does not hold.
    ArchiveFinding "The archive" {
        E2401 "this program was built without the archive",
        cause: "`dbbd archive` needs a database and an object store, which are compiled in by the feature `archive` only.",
        cure: "Install a package of dbbd, which has it, or build it with the feature `archive`." {
            NotBuilt => "this program was built without the archive", help: "build it with the feature `archive`";
        }
        E2402 "an address of the archive is not valid",
        cause: "The archive is at `sqlite:FILE` or `postgres://USER@HOST/DATABASE`, its store at `file:DIRECTORY` or `s3://BUCKET/PREFIX`. The spool is a directory of its own.",
        cure: "Give the archive and the store, or set DBBD_ARCHIVE and DBBD_STORE. docs/evidence/README.md has examples.",
        asks: [Archive, Store, Spool] {
            NoAddress { option: String, variable: String } => "{option} is missing", help: "give it, or set {variable}";
            OtherScheme { option: String, schemes: String } => "{option}: is none of {schemes}";
            NotAnAddress { option: String, why: String } => "{option}: {why}";
            NoPath { option: String } => "{option}: the path of a file or a directory is missing";
            SpoolInStore => "the spool is the directory of the store, or in it", help: "give a directory of its own";
            OtherSslMode { mode: String } => "sslmode={mode}: is not supported", help: "verify-full, or disable on this computer and in a tunnel";
            NoRootCertificate => "an encrypted connection needs the certificate of its authority", help: "add sslrootcert=FILE to the address";
        }
        E2403 "others can read a secret",
        cause: "A password is in an address, where it shows in the list of processes and in logs, or in a file that others may read.",
        cure: "Put the password into a file with mode 600 and its path into DBBD_ARCHIVE_PASSWORD_FILE, or into the variable PGPASSWORD; keys of the store into AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY or a file named by DBBD_STORE_SECRET_FILE." {
            SecretInAddress { option: String } => "{option}: an address must not have a password in it";
            SecretOpen => "others may read this secret", help: "chmod 600 the file";
            SecretUnreadable { why: String } => "the secret cannot be read: {why}";
            NotASecret { variable: String, form: String } => "{variable}: the file must have {form}";
        }
        E2404 "the archive cannot be reached",
        cause: "The database or the store is down, the network is cut, the address is wrong, or the certificate is not that of the host.",
        cure: "Try again. A spool keeps the run until the archive is back.",
        asks: [Spool] {
            NotReached { what: String, why: String } => "{what} cannot be reached: {why}";
        }
        E2405 "the database refuses",
        cause: "The role may not do this, the disk is full, or the database was changed by others.",
        cure: "The message is the database's own. docs/evidence/README.md lists what each role may do." {
            Refused { why: String } => "the database refuses: {why}";
            NotAValue { why: String } => "a value of a row or a parameter is not as expected: {why}";
        }
        E2406 "the store refuses",
        cause: "The keys may not do this, the bucket does not exist, or the disk is full.",
        cure: "The message is the store's own. A cell needs to read and write objects, a viewer and a worker to read them." {
            StoreRefused { object: String, why: String } => "{object}: the store refuses: {why}";
        }
        E2407 "the archive has another schema version",
        cause: "Nothing was initialised there yet, or another version of dbbd did it.",
        cure: "`dbbd archive init` creates an archive or migrates an older one; a newer one needs a newer dbbd.",
        asks: [Store] {
            NotInitialised => "there is no archive yet", help: "make it: `dbbd archive init`";
            Older { found: u64, needed: u64 } => "the archive has schema {found}; this version needs {needed}", help: "migrate it: `dbbd archive init`";
            Newer { found: u64, known: u64 } => "the archive has schema {found}; this version knows {known}", help: "use a newer version of dbbd";
            StoreNotInitialised => "the store was not initialised", help: "is the store mistyped? Else initialise it: `dbbd archive init`";
            OtherForm { step: u64 } => "migration {step} of the archive was made by another program";
        }
        E2408 "an object is not what was stored",
        cause: "The store lost or changed an object, or another program wrote there.",
        cure: "Push the run again from its cell, or restore the store from its backup. The object's name is its SHA-256." {
            Differs { object: String, found: String } => "{object}: has the SHA-256 {found}";
            Missing { object: String } => "{object}: is not in the store";
            NotAName { name: String } => "`{name}` is not the name of a file of a run";
        }
        E2409 "there is no such run in the archive",
        cause: "The digits are mistyped, this role may not see the run, or it was never pushed.",
        cure: "`dbbd archive list` shows the runs that this role may see. At least 6 digits of the SHA-256 are needed, as many as make it unique." {
            NoRun { digits: String } => "there is no run {digits}";
            ManyRuns { digits: String, runs: usize } => "{digits} is the beginning of {runs} runs", help: "give more digits";
            NotDigits { digits: String } => "`{digits}` is not the beginning of a SHA-256", help: "6 to 64 hexadecimal digits";
        }
        E2410 "there is nothing to push",
        cause: "The path is neither a capture, a directory with a run.dbbd, nor a directory of such directories.",
        cure: "Name a capture, the directory of a run, or the data directory of `dbbd serve`." {
            NothingToPush => "there is no run here";
            ChangedMeanwhile => "changed while it was read", help: "push it when the run is over";
        }
        E2411 "a setting of a job is not valid",
        cause: "A value holds other characters than those of lists of names, names no prior or model, or the job was written by another program.",
        cure: "Settings are those of `dbbd identify`: prior, parameters that are estimated or fixed, model.",
        asks: [Prior, Estimated, Fixed, Model] {
            OtherValue { option: String, value: String, known: String } => "{option}: `{value}` is none of {known}";
            NotASetting { option: String, value: String } => "{option}: `{value}` is not a list of names";
        }
        E2415 "there are no results to estimate a fleet from",
        cause: "No run of the selection was identified with the usual settings, none has a date, or a number in them is not finite.",
        cure: "Let `dbbd archive worker` identify the runs first." {
            NoFleet { results: usize } => "{results} results do not make a fleet";
        }
        E2417 "a job was abandoned",
        cause: "Its worker was killed repeatedly during the job: memory ran out, or the identification ends the process.",
        cure: "`dbbd archive get` and `dbbd identify` show what it does. `dbbd archive reprocess` asks for it again." {
            GivenUp { attempts: u64 } => "the worker was lost {attempts} times during the job";
        }
        W2427 "runs are left out of a fleet",
        cause: "No worker has identified them with the usual settings, or their results have no date or no covariance.",
        cure: "Let `dbbd archive worker` identify them; `dbbd archive show SHA256` says why one could not be." {
            NotInFleet { left: usize, runs: usize } => "{left} of {runs} runs are left out";
        }
        E2418 "a selection of runs has invalid dates",
        cause: "A date is not written as YYYY-MM-DD, is in the future, or the selection ends before it begins.",
        cure: "Dates are YYYY-MM-DD or YYYY-MM-DDThh:mm:ssZ, UTC: 2026-01-01 to 2026-02-01 is January.",
        asks: [Since, Until] {
            NotAMoment { option: String, text: String } => "{option}: `{text}` is not a date", help: "YYYY-MM-DD";
            InFuture { text: String } => "{text} is in the future";
            EndsBefore { since: String, until: String } => "{until}, the end, is not after {since}";
        }
        E2430 "a request to a page of the plant is not valid",
        cause: "The address was typed, or a link is of another version: a field is unknown, or its value is none of those that it can have.",
        cure: "Begin at the first page, /. A robot is at /robot?name=SERIAL, a bar at /bar?name=SERIAL, a run at /runs/SHA256." {
            NotAQuestion { why: String } => "the request cannot be read: {why}";
            NotACursor { text: String } => "after={text}: must be a date, a space and a SHA-256";
            NotADate { text: String } => "`{text}` is not a date", help: "YYYY-MM-DD";
        }
        E2431 "the archive has no such robot, bar or report",
        cause: "The name is mistyped, this role may not see its runs, or no worker has identified the run yet.",
        cure: "Search for it on the first page. A run gets its report from `dbbd archive worker`." {
            NoSuchRobot { robot: String } => "there is no robot `{robot}`";
            NoSuchBar { bar: String } => "there is no bar `{bar}`";
            NoReport { run: String } => "run {run} has no report yet";
        }
        W2412 "a run waits in the spool",
        cause: "The archive could not be reached.",
        cure: "The next `dbbd archive push` with the same spool sends it. Nothing was deleted.",
        asks: [Spool] {
            Spooled { run: String, why: String } => "run {run} waits in the spool: {why}";
            SpoolWaits { runs: usize } => "{runs} runs wait in the spool";
        }
        W2419 "the archive has no run of this name",
        cause: "The name or serial number is mistyped, this role may not see its runs, or none was pushed.",
        cure: "`dbbd archive list` shows the names; upper and lower case differ. A search finds parts of names.",
        asks: [Search] {
            NoneOf { option: String, name: String } => "no run has {option} `{name}`";
        }
        I2420 "the selection holds no run",
        cause: "No run satisfies all of the given conditions.",
        cure: "Leave out one of the options to see which it is." {
            NoneSelected => "the selection holds no run";
        }
        W2421 "a file of a run was not stored",
        cause: "It has another name than letters, digits, `.`, `_` and `-`, is deeper than one directory, is a link, or cannot be read.",
        cure: "Give the file another name, or put it into the directory of the run, and push again." {
            NotStored { file: String } => "{file} was not stored";
        }
        W2422 "a part of a run is not registered in the archive",
        cause: "The plan, the identity or the check that belongs to it cannot be read, so that robot, bar or decision are missing in the lists.",
        cure: "The files are stored as they are. The message says what is wrong in them; `dbbd info RUN` shows the capture." {
            NotRegistered { why: String } => "not all of the run is registered: {why}";
            NotACheck => "its decision is no word that dbbd writes";
        }
        W2423 "the store had lost objects of a run",
        cause: "The store lost or changed them, or somebody deleted them.",
        cure: "What was pushed now is complete again. Push what is missing from where it is, or restore the store from its backup; `dbbd archive reprocess` computes results again. See why the store lost it." {
            Restored { run: String, objects: usize } => "{objects} objects of run {run} were missing or damaged in the store, and are restored";
            Lost { run: String, file: String } => "{file} of run {run} is not in the store";
        }
        W2414 "runs could not be identified",
        cause: "A capture has no plan, too few of its poses have a length, or its worker ended repeatedly.",
        cure: "`dbbd archive show SHA256` has the reason of each; `dbbd archive get` and `dbbd identify` show it in full." {
            JobsFailed { jobs: u64 } => "{jobs} jobs failed";
        }
        I2426 "a run does not state its robot",
        cause: "The job and the capture have no serial number of the robot.",
        cure: "Give it in the table [identity] of the job, or to `dbbd acquire`: robots of one type without serial numbers are one robot in the archive.",
        asks: [Identity] {
            NoSerial { run: String, robot: String } => "run {run} has no serial number of its robot: it is stored as one of `{robot}`";
            NoRobot { run: String } => "run {run} states no robot";
        }
        I2413 "the archive holds the run already",
        cause: "The same capture was pushed before, from here or from another cell.",
        cure: "Nothing to do." {
            HeldAlready { run: String } => "the archive holds run {run} already";
        }
    }
}

impl ArchiveFinding {
    /// Whether an object of the store is lost or changed; other runs may be undamaged.
    pub fn is_damage(&self) -> bool {
        matches!(self, Self::Differs { .. } | Self::Missing { .. } | Self::NotAName { .. })
    }
}

findings! {
    /// What the runs of a plant show together.
    FleetFinding "The runs of a plant together" {
        W2416 "a bar jumped, or a robot changed suddenly",
        cause: "A bar was dropped or its ends were exchanged; a robot crashed, or was repaired or mastered again. Runs before and after disagree by more than drift and noise allow.",
        cure: "Have the bar certified again before its next run. Calibrate the robot again, and check what it did in between." {
            BarJumped { bar: String, um: f64, sd_um: f64 } => "bar {bar} jumped by {um:+.1} um (standard deviation {sd_um:.1} um)";
            RobotChanged { robot: String, times: usize } => "robot {robot} changed suddenly, {times} times";
        }
    }
}
