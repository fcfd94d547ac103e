// Shows the token once; the cookie that comes back opens the pages.

const said = document.getElementById("said");

// A link from elsewhere comes without the cookie that this browser may have.
if ((await fetch(location.href, { headers: { Accept: "text/html" } })).ok) location.reload();

document.getElementById("sign-in").addEventListener("submit", async (event) => {
  event.preventDefault();
  const token = document.getElementById("token").value;
  const answer = await fetch("/api/v1/session", {
    method: "POST",
    headers: { "Content-Type": "application/json" },
    body: JSON.stringify({ token }),
  });
  if (answer.ok) location.reload();
  else said.textContent = (await answer.json()).error;
});
