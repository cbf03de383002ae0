import { launch } from "./browser.js";
import { DIST } from "./scans.js";
import { StaticServer } from "./static-server.js";
const server = await new StaticServer(DIST, { "/a.laz": "/tmp/d/10.laz" }).start();
const browser = await launch();
const page = await browser.newPage();
await page.goto(server.address);
await page.waitForFunction(() => window.slicewalk !== undefined);
console.log(await page.evaluate(async () => {
  const blob = await (await fetch("a.laz")).blob();
  const file = new File([blob], "a.laz");
  const log = []; let last = "";
  const t0 = performance.now();
  const timer = setInterval(() => { const c = window.slicewalk.state().converting; const s = c ? c.stage : "-"; if (s !== last) { log.push([s, ((performance.now()-t0)/1000).toFixed(2)]); last = s; } }, 20);
  await window.slicewalk.open(file, { units: "m" });
  clearInterval(timer); log.push(["done", ((performance.now()-t0)/1000).toFixed(2)]);
  return log.map(String).join("\n");
}));
await browser.close(); await server.stop(); process.exit(0);
