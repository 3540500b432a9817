"""The report page's style sheet: light, dark and print, colours that colour-blind readers tell apart."""

STYLE = """
:root{color-scheme:light dark;--paper:#ffffff;--page:#eef0f2;--ink:#1b2127;--faint:#5a6570;--grid:#dde2e6;
--line:#c9d0d6;--good:#005f8f;--bad:#b23a00;--open:#6b5300;--good-fill:#dcecf6;--bad-fill:#fbe5d9;
--open-fill:#f8eecb;
--stop:#5a6570;--pallet:#c9a877;--sled:#aab3bb;
--band0:#4b3fa8;--band1:#0072b2;--band2:#1f8a7a;--band3:#857a12;--band4:#c8553d;--band5:#882255}
@media (prefers-color-scheme:dark){:root{--paper:#1b2026;--page:#12161a;--ink:#e8ecef;--faint:#a3aeb8;
--grid:#323a42;
--line:#414b55;--good:#7cc4f0;--bad:#ff9d66;--open:#f0cf5e;--good-fill:#12344a;--bad-fill:#4a2611;
--open-fill:#443808;
--stop:#a3aeb8;--pallet:#8a6f45;--sled:#59636d;
--band0:#a99cf0;--band1:#56b4e9;--band2:#5ed0bd;--band3:#d4cf5a;--band4:#f0836b;--band5:#e07fb0}}
@media print{:root{color-scheme:light;--paper:#fff;--page:#fff;--ink:#000;--faint:#444;--grid:#ddd;
--line:#bbb;
--good:#004a70;--bad:#9a3200;--open:#5a4600;--good-fill:#e4f0f8;--bad-fill:#fbe9df;--open-fill:#f8f0d4;
--stop:#444;--pallet:#c9a877;--sled:#aab3bb;
--band0:#4b3fa8;--band1:#0072b2;--band2:#1f8a7a;--band3:#857a12;--band4:#c8553d;--band5:#882255}}
*{box-sizing:border-box}
body{margin:0;background:var(--page);color:var(--ink);
font:15px/1.5 system-ui,-apple-system,"Segoe UI",Roboto,"Noto Sans","DejaVu Sans",Arial,sans-serif}
main{max-width:1120px;margin:0 auto;padding:24px 16px 48px}
header,section,footer{background:var(--paper);border:1px solid var(--line);border-radius:8px;
padding:20px 24px;margin:0 0 16px}
header{border-top:6px solid var(--open)}header.pass{border-top-color:var(--good)}
header.fail{border-top-color:var(--bad)}
h1{font-size:30px;line-height:1.2;margin:0 0 12px;overflow-wrap:anywhere}
h2{font-size:19px;line-height:1.3;margin:0 0 12px}
p{margin:0 0 8px;overflow-wrap:anywhere}
.kicker,.small,figcaption,.description{color:var(--faint)}.small,figcaption{font-size:13px;margin:10px 0 0}
.kicker{margin:0 0 4px;font-size:13px;letter-spacing:.02em}
.verdict{display:flex;gap:20px;align-items:center;border-radius:6px;padding:14px 18px;
background:var(--open-fill)}
.pass .verdict{background:var(--good-fill)}.fail .verdict{background:var(--bad-fill)}
.verdict p{margin:0;font-size:17px}
.verdict .badge{font-weight:700;font-size:24px;letter-spacing:.04em;white-space:nowrap;color:var(--paper);
background:var(--open);border-radius:6px;padding:6px 18px}
.pass .badge{background:var(--good)}.fail .verdict .badge{background:var(--bad)}
.pass .verdict .badge{background:var(--good)}
.notice{margin:12px 0 0;padding:8px 14px;border-left:4px solid var(--open)}
dl{display:grid;grid-template-columns:repeat(auto-fit,minmax(420px,1fr));gap:0 32px;margin:0}
dl div{display:grid;grid-template-columns:140px 1fr;gap:12px;padding:6px 0;
border-bottom:1px solid var(--grid)}
dt{color:var(--faint);overflow-wrap:anywhere}dd{margin:0;overflow-wrap:anywhere;
font-variant-numeric:tabular-nums}
.scroll{overflow-x:auto;margin:4px 0}
table{border-collapse:collapse;width:100%;font-variant-numeric:tabular-nums}
th,td{text-align:left;padding:7px 8px;border-bottom:1px solid var(--grid);vertical-align:top;
overflow-wrap:break-word}
thead th{color:var(--faint);font-weight:600;font-size:13px;border-bottom:2px solid var(--line);
vertical-align:bottom}
tbody th{font-weight:600;min-width:90px;max-width:420px}.rules tbody th{font-weight:400;min-width:180px}
.c{min-width:96px}
td{max-width:320px}
.n{text-align:right;white-space:nowrap}.u{white-space:nowrap}
.state{font-weight:700;white-space:nowrap}.state.pass{color:var(--good)}.state.fail{color:var(--bad)}
.state.unresolved{color:var(--open)}.state.off{color:var(--faint)}
.bar{display:inline-block;width:44px;height:9px;border:1px solid var(--faint);vertical-align:middle}
.bar span{display:block;height:100%;background:var(--open)}.bar.pass span{background:var(--good)}
.bar.fail span{background:var(--bad)}
figure{margin:0}.picture{margin:0 0 12px}
.picture img,.picture video{display:block;width:100%;height:auto;border-radius:4px}
.picture figcaption{color:var(--faint);font-size:.9em;padding-top:4px}.film dl{margin-top:14px}
svg{display:block;width:100%;height:auto}
svg *{stroke-linejoin:round;stroke-linecap:butt}
svg text{font-family:"DejaVu Sans",Verdana,"Segoe UI",Arial,sans-serif}
details{margin-top:10px}summary{cursor:pointer;padding:4px 0;font-weight:600}
ul{margin:0;padding-left:20px}li{margin:2px 0}
@media (max-width:640px){.verdict{flex-direction:column;align-items:flex-start}}
@media print{@page{margin:14mm}body{font-size:9.5pt}main{max-width:none;padding:0}
*{print-color-adjust:exact;-webkit-print-color-adjust:exact}
header,section,footer{border:0;border-radius:0;padding:0;margin:0 0 7mm}header{border-top:2mm solid;
padding-top:4mm}
figure,tr,dl div,.verdict{break-inside:avoid}h2{break-after:avoid}th,td{padding:3px 5px}.bar{width:36px}
.scroll{overflow:visible}table{font-size:8pt}.n{white-space:normal}
.c{min-width:0}.rules tbody th{min-width:0}}
"""
