//! The work on a robot in nine steps: the routes, and their requests.

use axum::body::Bytes;
use axum::extract::{Extension, State};
use axum::http::StatusCode;
use axum::http::header::{CONTENT_ENCODING, CONTENT_TYPE};
use axum::response::IntoResponse;
use axum::routing::{MethodRouter, get, post, put};
use serde_json::{Value, json};

use super::asking::{Answer, App, Parts, ask, job_number, parts, reply};
use super::guard::Asking;
use super::json::{Body, LongBody, json};
use super::server::Peer;
use super::work::{JobEdit, NewRobot, ProgramUpload, StepOptions, WorkStep};
use super::{Route, downloads};

/// Third-party scripts, as the renewing script made them, compressed; they are loaded when they are needed.
const VENDOR_SCRIPTS: [(&str, &[u8]); 2] = [
    ("/vendor/three.js", include_bytes!("page/vendor/three.js.gz")),
    ("/vendor/uplot.js", include_bytes!("page/vendor/uplot.js.gz")),
];

pub(super) fn table() -> Vec<Route<App>> {
    vec![
        ("/api/v1/workbench", "GET, POST", get(robots).merge(post(create))),
        ("/api/v1/workbench/{robot}", "GET", get(work)),
        ("/api/v1/workbench/{robot}/job", "GET, PUT", get(job_of).merge(put(edit_job))),
        ("/api/v1/workbench/{robot}/trial", "POST", post(try_job)),
        ("/api/v1/workbench/{robot}/scene", "GET", get(scene)),
        ("/api/v1/workbench/{robot}/program", "PUT", put(upload)),
        ("/api/v1/workbench/{robot}/steps/{step}", "POST", post(compute)),
        ("/api/v1/workbench/{robot}/files/{directory}/{file}", "GET", get(work_file)),
        ("/api/v1/demo", "POST", post(demo)),
        ("/api/v1/jobs/{id}/answer", "GET", get(job_answer)),
    ]
}

/// The routes of the third-party scripts: every browser takes gzip.
pub(super) fn vendor_scripts() -> impl Iterator<Item = Route<App>> {
    let route = |(path, script): (&'static str, &'static [u8])| {
        let answer = move || async move {
            let headers = [(CONTENT_TYPE, "text/javascript; charset=utf-8"), (CONTENT_ENCODING, "gzip")];
            (headers, Bytes::from_static(script)).into_response()
        };
        let handlers: MethodRouter<App> = get(answer);
        (path, "GET", handlers)
    };
    VENDOR_SCRIPTS.into_iter().map(route)
}

async fn robots(State(app): State<App>) -> Answer {
    reply(app, |service| Ok(json!({ "robots": service.robots()? }))).await
}

async fn create(State(app): State<App>, Body(new): Body<NewRobot>) -> Answer {
    let name = new.name.clone();
    ask(app, move |service| service.create(new)).await?;
    Ok(json(StatusCode::CREATED, &json!({ "name": name })))
}

async fn demo(State(app): State<App>) -> Answer {
    let name = ask(app, |service| service.demo()).await?;
    Ok(json(StatusCode::CREATED, &json!({ "name": name })))
}

async fn work(State(app): State<App>, robot: Parts<String>) -> Answer {
    let robot = parts(robot)?;
    reply(app, move |service| service.work(&robot)).await
}

async fn job_of(State(app): State<App>, robot: Parts<String>) -> Answer {
    let robot = parts(robot)?;
    reply(app, move |service| service.job_of(&robot)).await
}

async fn edit_job(State(app): State<App>, robot: Parts<String>, Body(edit): Body<JobEdit>) -> Answer {
    let robot = parts(robot)?;
    ask(app, move |service| service.edit_job(&robot, &edit)).await?;
    Ok(StatusCode::NO_CONTENT.into_response())
}

async fn try_job(State(app): State<App>, robot: Parts<String>, Body(keys): Body<Value>) -> Answer {
    let robot = parts(robot)?;
    reply(app, move |service| service.try_job(&robot, &keys)).await
}

async fn scene(State(app): State<App>, robot: Parts<String>) -> Answer {
    let robot = parts(robot)?;
    reply(app, move |service| service.scene(&robot)).await
}

async fn upload(
    State(app): State<App>,
    robot: Parts<String>,
    LongBody(files): LongBody<ProgramUpload>,
) -> Answer {
    let robot = parts(robot)?;
    ask(app, move |service| service.upload(&robot, files)).await?;
    Ok(StatusCode::NO_CONTENT.into_response())
}

async fn compute(
    State(app): State<App>,
    Extension(Asking(user)): Extension<Asking>,
    path: Parts<(String, WorkStep)>,
    Body(mut options): Body<StepOptions>,
) -> Answer {
    options.by.clone_from(&user.name);
    let (robot, step) = parts(path)?;
    let job = ask(app, move |service| service.compute(&robot, step, options)).await?;
    Ok(json(StatusCode::ACCEPTED, &job))
}

async fn work_file(
    State(app): State<App>,
    Extension(peer): Extension<Peer>,
    path: Parts<(String, String, String)>,
) -> Answer {
    let (robot, directory, file) = parts(path)?;
    let download = ask(app, move |service| service.work_file(&robot, &directory, &file)).await?;
    Ok(downloads::answer(download, peer.busy()))
}

async fn job_answer(State(app): State<App>, id: Parts<String>) -> Answer {
    let id = job_number(id)?;
    reply(app, move |service| service.job_answer(id)).await
}
