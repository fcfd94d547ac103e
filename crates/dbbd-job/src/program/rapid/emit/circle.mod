{% macro millimetres(p) %}[{{ p[0]|mm }},{{ p[1]|mm }},{{ p[2]|mm }}]{% endmacro -%}
{% macro turn(q) %}[{{ q[0]|fine }},{{ q[1]|fine }},{{ q[2]|fine }},{{ q[3]|fine }}]{% endmacro -%}
{% macro axes(a) %}[{% for angle in a %}{{ "" if loop.first else "," }}{{ angle|axis }}{% endfor %}]{% endmacro -%}
{% macro external() %}[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]{% endmacro -%}
MODULE {{ name }}
{% for line in plan.made %}
{{ line }}
{% endfor %}
  ! ball-bar calibration, plan {{ plan.hash }}, robot {{ plan.robot }}
  LOCAL CONST string DBBPLAN:="{{ plan.hash }}";
  ! number and centre of the base ball, bar length, stroke, mm
  LOCAL CONST num DBBBALL:={{ ball }};
  LOCAL CONST pos DBBCEN:={{ millimetres(centre) }};
  LOCAL CONST num DBBLEN:={{ plan.bar.length_mm|mm }};
  LOCAL CONST num DBBLOW:={{ plan.bar.stroke_mm[0]|mm }};
  LOCAL CONST num DBBHIGH:={{ plan.bar.stroke_mm[1]|mm }};
  LOCAL PERS tooldata DBBTOOL:=[TRUE,[{{ millimetres(plan.tool.place) }},{{ turn(plan.tool.turn) }}],[{{ plan.payload.kg|mm }},{{ millimetres(plan.payload.centre) }},[1,0,0,0],0,0,0]];
  LOCAL PERS wobjdata DBBWOBJ:=[FALSE,TRUE,"",[{{ millimetres(plan.base.place) }},{{ turn(plan.base.turn) }}],[[0,0,0],[1,0,0,0]]];
  LOCAL CONST jointtarget XSTART:=[{{ axes(start_deg) }},{{ external() }}];
  ! points, and speeds along the path (mm/s) and of the orientation (degrees/s)
{% for point in points %}
{% if point.axes %}
  LOCAL CONST jointtarget XP{{ loop.index }}:=[{{ axes(point.axes) }},{{ external() }}];
{% else %}
  LOCAL CONST robtarget XP{{ loop.index }}:=[{{ millimetres(point.place) }},{{ turn(point.turn) }},[{{ point.configuration[0] }},{{ point.configuration[1] }},{{ point.configuration[2] }},{{ point.configuration[3] }}],{{ external() }}];
{% endif %}
{% if point.speeds %}
  LOCAL CONST speeddata VP{{ loop.index }}:=[{{ point.speeds[0]|mm }},{{ point.speeds[1]|deg }},5000,1000];
{% endif %}
{% endfor %}

  PROC {{ name }}_RUN()
    ! circle {{ circle }}, plan {{ plan.hash }}
{% if plan.sync == "output" %}
    SetDO DBBSTB,0;
    SetGO DBBIDX,0;
{% endif %}
    ! the branch of the arm is that of the start; lines and arcs keep it
    ConfL\Off;
    PathAccLim TRUE\AccMax:={{ (plan.acceleration_mm_s2 * 1e-3)|speed }},TRUE\DecelMax:={{ (plan.acceleration_mm_s2 * 1e-3)|speed }};
    MoveAbsJ XSTART,v100,fine,DBBTOOL\WObj:=DBBWOBJ;
{% if stays %}
    ! the ball bar stays on ball {{ ball }}
{% else %}
    WaitRob\ZeroSpeed;
    TPWrite "mount the ball bar on ball {{ ball }} now, then press start";
    Stop;
{% endif %}
{% if plan.sync == "output" %}
    WaitRob\ZeroSpeed;
    DbbSync;
    DbbSync;
    DbbSync;
{% endif %}
{% for step in steps %}
    ! row {{ step.index }}, {{ step.kind }}
{# The time of a motion: the acceleration of an orientation cannot be set. #}
{% set time %}{% if step.duration_s > 0 %}\T:={{ step.duration_s|seconds }}{% endif %}{% endset %}
{% if step.motion == "ptp" %}
    MoveAbsJ XP{{ step.row }},v100{{ time }},fine,DBBTOOL\WObj:=DBBWOBJ;
{% elif step.through %}
    MoveC XP{{ step.through }},XP{{ step.row }},VP{{ step.row }}{{ time }},fine,DBBTOOL\WObj:=DBBWOBJ;
{% else %}
    MoveL XP{{ step.row }},VP{{ step.row }}{{ time }},fine,DBBTOOL\WObj:=DBBWOBJ;
{% endif %}
{% if step.number %}
    DbbMark {{ step.number }},{{ step.dwell_s|seconds }};
{% endif %}
{% if plan.sync == "output" and step.row == end_mark %}
    WaitRob\ZeroSpeed;
    DbbSync;
    DbbSync;
{% endif %}
{% endfor %}
    PathAccLim FALSE,FALSE;
    ConfL\On;
  ENDPROC
{% if stops %}

  LOCAL PROC DbbMark(num n,num dwell_s)
    ! stand still: `fine` is the end of the command, not of the motion; settle, see that it is at rest, dwell
    WaitTime {{ plan.settle_s|seconds }};
    WaitRob\InPos;
    WaitRob\ZeroSpeed;
{% if plan.sync == "output" %}
    SetGO DBBIDX,n;
    SetDO DBBSTB,1;
    WaitTime dwell_s;
    SetDO DBBSTB,0;
{% else %}
    WaitTime dwell_s;
{% endif %}
    WaitTime 0.1;
  ENDPROC
{% endif %}
{% if plan.sync == "output" %}

  LOCAL PROC DbbSync()
    ! a short pulse of the strobe: 3 at the start, 2 at the end
    PulseDO\PLength:=0.2,DBBSTB;
    WaitTime 0.6;
  ENDPROC
{% endif %}
ENDMODULE
